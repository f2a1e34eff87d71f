//! The bytes of serial lines as they are: a file for each line and direction.

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::super::{BusHead, FrameWriter};
use super::kept::Unkept;
use crate::frame::{Direction, Frame, Stamped};

/// Makes the file of a line and a direction.
pub type Create<W> = Box<dyn FnMut(&str, Direction) -> io::Result<W>>;

/// Files are made by `create` when there are bytes for them.
pub fn create<W: Write>(create: Create<W>, buses: &[BusHead]) -> impl FrameWriter + use<W> {
    let names = buses.iter().map(|bus| bus.name.clone()).collect();
    Raw { create, names, files: BTreeMap::new(), unkept: Unkept::default() }
}

struct Raw<W> {
    create: Create<W>,
    names: Vec<String>,
    /// By bus, then received or sent.
    files: BTreeMap<(u16, bool), W>,
    unkept: Unkept,
}

impl<W: Write> FrameWriter for Raw<W> {
    fn add_bus(&mut self, bus: &BusHead) -> io::Result<()> {
        self.names.push(bus.name.clone());
        Ok(())
    }

    fn write(&mut self, bus: u16, frame: &Stamped<Frame>) -> io::Result<()> {
        let (Frame::Serial(bytes), Some(name)) = (&frame.value, self.names.get(usize::from(bus)))
        else {
            self.unkept.frame(&frame.value);
            return Ok(());
        };
        self.unkept.add("times");
        let key = (bus, bytes.direction == Direction::Tx);
        if !self.files.contains_key(&key) {
            self.files.insert(key, (self.create)(name, bytes.direction)?);
        }
        match self.files.get_mut(&key) {
            Some(file) => file.write_all(&bytes.data),
            None => Ok(()),
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        self.files.values_mut().try_for_each(Write::flush)
    }

    fn unkept(&self) -> &BTreeMap<&'static str, u64> {
        self.unkept.list()
    }
}
