//! Blocks of MDF 4: identifier, length, links to other blocks by their address, data.

/// Bytes in front of the links: identifier, reserved, length, number of links.
pub(super) const HEAD: usize = 24;

/// A block, to stand at an address that divides by 8.
pub(super) fn block(id: &[u8; 4], links: &[u64], data: &[u8]) -> Vec<u8> {
    let length = HEAD + 8 * links.len() + data.len();
    let mut bytes = Vec::with_capacity(length + 8);
    bytes.extend(id);
    bytes.extend([0; 4]);
    bytes.extend((length as u64).to_le_bytes());
    bytes.extend((links.len() as u64).to_le_bytes());
    bytes.extend(links.iter().flat_map(|link| link.to_le_bytes()));
    bytes.extend(data);
    pad(&mut bytes);
    bytes
}

/// Text (`##TX`) or XML (`##MD`), with the zero at its end.
pub(super) fn text(id: &[u8; 4], text: &str) -> Vec<u8> {
    let mut data = text.replace('\0', " ").into_bytes();
    data.push(0);
    data.resize(data.len().next_multiple_of(8), 0);
    block(id, &[], &data)
}

/// Fills up to the next address that divides by 8.
pub(super) fn pad(bytes: &mut Vec<u8>) {
    bytes.resize(bytes.len().next_multiple_of(8), 0);
}

/// Blocks collected one behind the other, from a known address on.
pub(super) struct Blocks {
    start: u64,
    pub bytes: Vec<u8>,
}

impl Blocks {
    pub fn new(start: u64) -> Self {
        Self { start, bytes: Vec::new() }
    }

    /// Adds a block; its address.
    pub fn add(&mut self, block: &[u8]) -> u64 {
        let address = self.start + self.bytes.len() as u64;
        self.bytes.extend(block);
        address
    }

    pub fn text(&mut self, string: &str) -> u64 {
        self.add(&text(b"##TX", string))
    }
}
