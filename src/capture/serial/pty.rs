//! A pseudo-terminal that we make: what somebody writes to it is recorded.

use std::io;
use std::path::PathBuf;

use tokio::io::Interest;

use super::last::LastReads;
use super::link::Link;
use super::port::READ_BYTES;
use crate::capture::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{Direction, Frame, SerialBytes, Unit};
use crate::queue::Inlet;
use crate::sys::pty::Pty;
use crate::sys::wait::register;

/// The pseudo-terminal and its link.
pub struct PtySource {
    pty: Pty,
    link: Link,
    path: PathBuf,
}

/// A new pseudo-terminal, linked at `path`.
pub(crate) fn linked(path: &std::path::Path) -> Result<(Pty, Link), CaptureError> {
    let pty = Pty::new()
        .map_err(|e| CaptureError(format!("cannot make a pseudo-terminal: {e} (see pty(7))")))?;
    let link = Link::make(path, pty.path())?;
    Ok((pty, link))
}

impl PtySource {
    /// Makes a pseudo-terminal, raw from the start, and links it at `path`.
    pub fn open(path: PathBuf) -> Result<Self, CaptureError> {
        let (pty, link) = linked(&path)?;
        Ok(Self { pty, link, path })
    }
}

impl Source for PtySource {
    fn facts(&self) -> BusFacts {
        let mut facts = BusFacts { unit: Some(Unit::Bytes), ..BusFacts::default() };
        for (name, text) in [
            ("kind", "pty".to_owned()),
            ("port", self.path.display().to_string()),
            ("timestamps", "read".to_owned()),
        ] {
            facts.more.insert(name.to_owned(), text);
        }
        facts
    }

    fn run<'a>(self: Box<Self>, mut inlet: Inlet, mut stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            // The link goes when the recording ends, also when it fails.
            let Self { pty, link: _link, path } = *self;
            let failed = |error: io::Error| {
                CaptureError(format!("reading from {} failed: {error}", path.display()))
            };
            let pty = register(pty, Interest::READABLE).map_err(failed)?;
            let mut buffer = vec![0; READ_BYTES];
            loop {
                tokio::select! {
                    () = stop.requested() => break,
                    read = pty.async_io(Interest::READABLE, |pty| pty.read(&mut buffer)) => {
                        record(&mut inlet, &buffer[..read.map_err(failed)?]);
                    }
                }
            }
            let mut last = LastReads::new();
            while last.more()
                && let Ok(length @ 1..) = pty.get_ref().read(&mut buffer)
            {
                record(&mut inlet, &buffer[..length]);
                last.took(length);
            }
            Ok(())
        })
    }
}

fn record(inlet: &mut Inlet, read: &[u8]) {
    let time = inlet.timeline().now();
    let (direction, data, errors) = (Direction::Rx, read.to_vec(), Vec::new());
    inlet.push_one(time, Frame::Serial(SerialBytes { direction, data, errors }));
}
