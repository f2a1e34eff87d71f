//! The decoded channels that go into one row of files: one stream a bus, each ends alone.

use super::progress::Progress;
use crate::channels::Stream;
use crate::frame::{Frame, Level, Notice, Stamped, Timestamp};
use crate::recording::writer::SegmentWriter;

/// For each bus its decoded channels, if it is decoded.
pub struct Decoders(pub Vec<Option<Stream>>);

impl Decoders {
    /// Adds what `frame` of bus number `bus` means.
    #[inline]
    pub fn take(
        &mut self,
        bus: usize,
        frame: &Stamped<Frame>,
        writer: &mut SegmentWriter,
        progress: &Progress,
    ) {
        self.run(bus, frame.time, (writer, progress), |stream, writer| stream.take(frame, writer));
    }

    /// Everything that happened before `time` has been taken.
    pub fn pass(&mut self, time: Timestamp, writer: &mut SegmentWriter, progress: &Progress) {
        for bus in 0..self.0.len() {
            self.run(bus, time, (writer, progress), |stream, writer| stream.pass(time, writer));
        }
    }

    /// Nothing more comes.
    pub fn finish(&mut self, time: Timestamp, writer: &mut SegmentWriter, progress: &Progress) {
        for bus in 0..self.0.len() {
            self.run(bus, time, (writer, progress), |stream, writer| stream.finish(writer));
        }
    }

    /// A new file begins.
    pub fn new_file(&mut self) {
        self.0.iter_mut().flatten().for_each(Stream::new_segment);
    }

    /// That of bus number `bus`.
    pub fn of(&self, bus: usize) -> Option<&Stream> {
        self.0.get(bus)?.as_ref()
    }

    fn run(
        &mut self,
        bus: usize,
        time: Timestamp,
        (writer, progress): (&mut SegmentWriter, &Progress),
        work: impl FnOnce(&mut Stream, &mut SegmentWriter) -> Result<(), String>,
    ) {
        let Some(Some(stream)) = self.0.get_mut(bus) else { return };
        if let Err(why) = work(stream, writer) {
            progress.notice(Level::Error, why.clone());
            let notice = Notice { level: Level::Error, text: why };
            let name = format!("{}/decode", stream.bus());
            // Where not even the log finds room, the summary tells.
            writer.add_notice(time, &name, &notice).ok();
        }
    }
}
