//! A group of records with the same fields: its data blocks and its description.

use std::io::{self, Write};

use flate2::{Compress, Compression, FlushCompress, Status};

use super::block::{Blocks, block, pad};
use super::record::{Field, Kind, TIME};
use crate::frame::CanFrame;

/// Records of one block, bytes before compression.
const BLOCK: usize = 512 << 10;
/// A DZ block's own data in front of the compressed ones.
const DZ_HEAD: usize = 24;
const UNSIGNED: u8 = 0;
const BYTES: u8 = 10;

/// Records on their way, and where those before them are.
pub(super) struct Group {
    kind: Kind,
    records: Vec<u8>,
    count: u64,
    /// Address of each block, and how many bytes are before it.
    blocks: Vec<(u64, u64)>,
    written: u64,
}

impl Group {
    pub fn new(kind: Kind) -> Self {
        Self { kind, records: Vec::new(), count: 0, blocks: Vec::new(), written: 0 }
    }

    pub fn add(&mut self, time: u64, channel: u8, frame: &CanFrame) {
        self.kind.record(&mut self.records, time, channel, frame);
        self.count += 1;
    }

    /// Bytes that wait to be written.
    pub fn waiting(&self) -> usize {
        self.records.len()
    }

    pub fn is_full(&self) -> bool {
        self.records.len() + self.kind.size() > BLOCK
    }

    /// Writes what waits as one block to address `at`; its length.
    pub fn write_block(&mut self, out: &mut impl Write, at: u64) -> io::Result<u64> {
        if self.records.is_empty() {
            return Ok(0);
        }
        let size = self.kind.size();
        let columns = transposed(&self.records, size);
        let mut data = Vec::with_capacity(DZ_HEAD + columns.len() + columns.len() / 1000 + 64);
        data.extend([0; DZ_HEAD]);
        let mut compress = Compress::new(Compression::new(LEVEL), true);
        let status = compress.compress_vec(&columns, &mut data, FlushCompress::Finish)?;
        if status != Status::StreamEnd {
            return Err(io::Error::other("a block could not be compressed in one go"));
        }
        let packed = (data.len() - DZ_HEAD) as u64;
        // What it was: data (DT); transposed and deflated (1), in columns of the record's bytes.
        data[..4].copy_from_slice(b"DT\x01\0");
        data[4..8].copy_from_slice(&u32::try_from(size).unwrap_or(0).to_le_bytes());
        data[8..16].copy_from_slice(&(columns.len() as u64).to_le_bytes());
        data[16..24].copy_from_slice(&packed.to_le_bytes());
        let mut bytes = block(b"##DZ", &[], &data);
        pad(&mut bytes);
        out.write_all(&bytes)?;
        self.blocks.push((at, self.written));
        self.written += columns.len() as u64;
        self.records.clear();
        Ok(bytes.len() as u64)
    }

    /// Adds the blocks that describe the group; the address of its data group, in front of `next`.
    pub fn describe(&self, blocks: &mut Blocks, bus: &str, next: u64) -> u64 {
        let (name, path) = (blocks.text(bus), blocks.text("CAN"));
        // A bus (2), namely CAN (2).
        let source = blocks.add(&block(b"##SI", &[name, path, 0], &[2, 2, 0, 0, 0, 0, 0, 0]));
        let event = self.kind.event();
        let mut first = 0;
        for field in self.kind.fields().into_iter().rev() {
            let name = blocks.text(&format!("{event}.{}", field.name));
            let kind = if field.name == "DataBytes" { BYTES } else { UNSIGNED };
            first = blocks.add(&channel([first, 0, name, source], 0, kind, 0, field));
        }
        let all = u32::try_from(self.kind.size()).unwrap_or(0) - TIME;
        let whole = Field { name: event, at: TIME, size: all };
        let name = blocks.text(event);
        let parent = blocks.add(&channel([0, first, name, source], 0, BYTES, 0, &whole));
        let (name, unit) = (blocks.text("Timestamp"), blocks.text("s"));
        let seconds = blocks.add(&nanoseconds(unit));
        let time = Field { name: "Timestamp", at: 0, size: TIME };
        let master = blocks.add(&channel([parent, 0, name, 0], 2, UNSIGNED, seconds, &time));
        let acquisition = blocks.text(bus);
        let mut data = 0_u64.to_le_bytes().to_vec();
        data.extend(self.count.to_le_bytes());
        // A bus event, and plain: no signals decoded. Fields' names are parted by a point.
        data.extend([6, 0, b'.', 0, 0, 0, 0, 0]);
        data.extend((all + TIME).to_le_bytes());
        data.extend([0; 4]);
        let links = [0, master, acquisition, source, 0, 0];
        let group = blocks.add(&block(b"##CG", &links, &data));
        let list = self.list(blocks);
        blocks.add(&block(b"##DG", &[next, group, list, 0], &[0; 8]))
    }

    /// The list of the data blocks.
    fn list(&self, blocks: &mut Blocks) -> u64 {
        let mut links = vec![0];
        links.extend(self.blocks.iter().map(|(address, _)| address));
        let count = u32::try_from(self.blocks.len()).unwrap_or(u32::MAX);
        let mut data = vec![0; 4];
        data.extend(count.to_le_bytes());
        data.extend(self.blocks.iter().flat_map(|(_, before)| before.to_le_bytes()));
        let list = blocks.add(&block(b"##DL", &links, &data));
        blocks.add(&block(b"##HL", &[list], &[0, 0, 1, 0, 0, 0, 0, 0]))
    }
}

/// zlib's level: transposed records gain little above it, and cost twice as much.
const LEVEL: u32 = 4;

/// The first byte of all records, then the second, ...
fn transposed(records: &[u8], size: usize) -> Vec<u8> {
    let count = records.len() / size;
    let mut columns = vec![0; records.len()];
    for (row, record) in records.chunks_exact(size).enumerate() {
        for (column, byte) in record.iter().enumerate() {
            columns[column * count + row] = *byte;
        }
    }
    columns
}

/// A channel (CN): next one, composition, name and source; what it is for (0 value, 2 master by
/// time); its type; its conversion; where it is.
fn channel(links: [u64; 4], role: u8, data_type: u8, conversion: u64, field: &Field) -> Vec<u8> {
    let [next, composition, name, source] = links;
    let links = [next, composition, name, source, conversion, 0, 0, 0];
    let synchronised = u8::from(role == 2);
    let mut data = vec![role, synchronised, data_type, 0];
    data.extend(field.at.to_le_bytes());
    data.extend((8 * field.size).to_le_bytes());
    // Part of a bus event.
    let flags: u32 = if role == 2 { 0 } else { 1 << 10 };
    data.extend(flags.to_le_bytes());
    data.resize(24 + 48, 0);
    block(b"##CN", &links, &data)
}

/// The conversion (CC) from nanoseconds to seconds: linear, 0 and 1e-9.
fn nanoseconds(unit: u64) -> Vec<u8> {
    let mut data = vec![1, 0, 0, 0, 0, 0, 2, 0];
    data.extend([0; 16]);
    data.extend(0_f64.to_le_bytes());
    data.extend(1e-9_f64.to_le_bytes());
    block(b"##CC", &[0, unit, 0, 0], &data)
}
