//! Onto a real serial port.

use std::io;
use std::os::fd::{AsFd as _, BorrowedFd};
use std::path::PathBuf;

use super::{Blocked, Due, Heard, Sink, Took};
use crate::capture::serial::{PortSpec, SerialSettings, Use};
use crate::frame::Frame;
use crate::permit::Permit;
use crate::replay::ReplayError;
use crate::sys::tty::Tty;

/// A serial port.
pub struct SerialSink {
    path: PathBuf,
    tty: Tty,
    /// Bytes of the first piece that are gone already.
    offset: usize,
    notes: Vec<String>,
}

impl SerialSink {
    /// Opens the port and sets its line.
    pub fn open(
        path: PathBuf,
        settings: SerialSettings,
        _permit: &Permit,
    ) -> Result<Self, ReplayError> {
        let (spec, opened) = PortSpec::open_first(path, settings, Use::Talk)
            .map_err(|error| ReplayError(error.0))?;
        let notes = opened.notes.into_iter().map(|(_, text)| text).collect();
        Ok(Self { path: spec.path, tty: opened.tty, offset: 0, notes })
    }

    fn trouble(&self, error: &io::Error) -> ReplayError {
        ReplayError(format!("{} went away while it was played to: {error}", self.path.display()))
    }
}

impl Sink for SerialSink {
    fn send(&mut self, front: &[Due]) -> Result<Took, ReplayError> {
        for (done, due) in front.iter().enumerate() {
            let Frame::Serial(bytes) = &due.item.frame else { continue };
            while let Some(rest) = bytes.data.get(self.offset..).filter(|rest| !rest.is_empty()) {
                match self.tty.write(rest) {
                    Ok(written) => self.offset += written,
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                        return Ok(Took::blocked(done, Blocked::Writable));
                    }
                    Err(error) => return Err(self.trouble(&error)),
                }
            }
            self.offset = 0;
        }
        Ok(Took::sent(front.len()))
    }

    fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.tty.as_fd())
    }

    fn listens(&self) -> bool {
        true
    }

    fn hear(&mut self, take: &mut dyn FnMut(Heard<'_>)) -> Result<(), ReplayError> {
        let mut buffer = [0; 4096];
        loop {
            match self.tty.read(&mut buffer) {
                // A tty that has hung up answers so for ever.
                Ok(0) => return Err(self.trouble(&io::Error::other("it hung up"))),
                Ok(length) => take(Heard::Serial(&buffer[..length])),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(self.trouble(&error)),
            }
        }
    }

    fn finish(&mut self) -> Result<bool, ReplayError> {
        Ok(self.tty.unsent() == 0)
    }

    fn notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }
}
