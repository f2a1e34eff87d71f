//! A decoder that panics, and names.

use std::io;
use std::sync::{Arc, Mutex};

use super::labels::Values;
use super::names::{Scope, identifier};
use super::schema::schema;
use super::shape::Shape;
use super::stream::{Decode, Out, Stream};
use crate::frame::{CanFlags, CanFrame, Frame, Stamped, Timestamp};
use crate::recording::definition::Facts;
use crate::recording::disk::OutputFile;
use crate::recording::reader::{Entry, Recording};
use crate::recording::writer::{Head, SegmentWriter, WriterOptions};

/// Writes half of a message and panics.
struct Broken;

impl Decode for Broken {
    fn take(&mut self, frame: &Stamped<Frame>, out: &mut Out<'_>) -> io::Result<()> {
        let define = || Some(("M".to_owned(), schema("a", "M", &Shape::default())));
        out.add(0, frame.time, define, |bytes| {
            bytes.extend_from_slice(b"half");
            panic!("bits are missing");
        })
    }

    fn pass(&mut self, _: Timestamp, _: &mut Out<'_>) -> io::Result<()> {
        Ok(())
    }

    fn finish(&mut self, _: &mut Out<'_>) -> io::Result<()> {
        Ok(())
    }
}

#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl io::Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl OutputFile for Shared {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_panic_ends_the_decoder_and_takes_back_what_it_had_begun() {
    let out = Shared::default();
    let head = Head { buses: vec![("can0".to_owned(), Facts::new())], ..Head::default() };
    let options = WriterOptions::default();
    let mut writer = SegmentWriter::create(Box::new(out.clone()), options, &head).unwrap();
    let mut stream = Stream::of("can0", "broken", Box::new(Broken));
    let frame = |n: u64| {
        let can = CanFrame::new(1, CanFlags::default(), &n.to_le_bytes());
        Stamped { time: Timestamp(n), value: Frame::Can(can) }
    };
    for n in 1..=3 {
        writer.add(0, &frame(n)).unwrap();
        let taken = stream.take(&frame(n), &mut writer);
        // Once.
        assert_eq!(taken.is_err(), n == 1, "{taken:?}");
    }
    assert!(stream.stopped().unwrap().contains("a fault in the decoder (bits are missing)"));
    writer.finish(Facts::new()).unwrap();
    let path = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(path.path(), &*out.0.lock().unwrap()).unwrap();
    let recording = Recording::open(&[path.path().to_owned()]).unwrap();
    let mut entries = recording.entries(Recording::ALL, |_| true);
    let read: Vec<_> = entries.by_ref().map(|entry| entry.value).collect();
    let written: Vec<_> = (1..=3).map(|n| Entry::Frame(0, frame(n).value)).collect();
    assert_eq!(read, written);
    assert!(entries.damage().is_empty(), "{:?}", entries.damage());
}

#[test]
fn texts_become_identifiers() {
    for (text, name) in [
        ("N/A", "N_A"),
        ("1 st", "_1_st"),
        ("", ""),
        ("\u{b0}\u{b0}", ""),
        ("  on  ", "on"),
        ("__proto__", "__proto___"),
        ("Gr\u{fc}n", "Gr_n"),
    ] {
        assert_eq!(identifier(text), name, "{text}");
    }
}

#[test]
fn names_that_some_readers_take_for_the_same_are_told_apart() {
    let mut scope = Scope::default();
    let given = ["Temp_1", "Temp1", "temp1", "Temp1_2"].map(|name| scope.take(name));
    assert_eq!(given, ["Temp_1", "Temp1_2", "temp1_3", "Temp1_2_2"]);
}

#[test]
fn many_equal_texts_cost_no_more_than_their_number() {
    let labels: Vec<_> = (0..200_000).map(|n| (n, "reserved".to_owned())).collect();
    assert_eq!(Values::of(&labels).named.len(), labels.len());
}

#[test]
fn zero_comes_first_and_is_made_where_it_is_missing() {
    let labels = |list: &[(i128, &str)]| -> Vec<(i128, String)> {
        list.iter().map(|(number, text)| (*number, (*text).to_owned())).collect()
    };
    let values = Values::of(&labels(&[(-1, "SNA"), (0, "Label"), (0, "again"), (1 << 40, "x")]));
    assert_eq!(values.named, [(0, "Label_2".to_owned()), (-1, "SNA".to_owned())]);
    assert_eq!(values.texts, labels(&[(0, "Label"), (1 << 40, "x")]));
    let values = Values::of(&labels(&[(2, "RAW_0"), (3, "")]));
    let names: Vec<_> = values.named.iter().map(|(_, name)| name.as_str()).collect();
    assert_eq!(names, ["RAW_0_2", "RAW_0", "VALUE_3"]);
}
