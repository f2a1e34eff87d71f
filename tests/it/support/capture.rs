//! Captures and measurement files, byte by byte, as no tool at hand writes them.

/// A pcapng file of blocks.
pub struct Capture(pub Vec<u8>);

pub const CAN: u16 = 227;
pub const SERIAL: u16 = 250;

impl Capture {
    pub fn new() -> Self {
        let mut capture = Self(Vec::new());
        let section = [&[0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0][..], &[0xFF; 8]].concat();
        capture.block(0x0A0D_0D0A, &section);
        capture
    }

    fn block(&mut self, kind: u32, body: &[u8]) {
        let padded = body.len().next_multiple_of(4);
        let length = (12 + padded as u32).to_le_bytes();
        self.0.extend(kind.to_le_bytes());
        self.0.extend(length);
        self.0.extend(body);
        self.0.resize(self.0.len() + padded - body.len(), 0);
        self.0.extend(length);
    }

    /// An interface with times in nanoseconds, and more options: code and value.
    pub fn interface(mut self, link: u16, name: &str, more: &[(u16, &[u8])]) -> Self {
        let mut body = [link, 0, 0, 0].map(u16::to_le_bytes).concat();
        let options = [(2, name.as_bytes()), (9, &[9][..])];
        for (code, value) in options.iter().chain(more) {
            body.extend(code.to_le_bytes());
            body.extend((value.len() as u16).to_le_bytes());
            body.extend(*value);
            body.resize(body.len().next_multiple_of(4), 0);
        }
        self.block(1, &body);
        self
    }

    /// A packet, of which `length` bytes were there.
    pub fn packet(mut self, interface: u32, nanos: u64, data: &[u8], length: usize) -> Self {
        let words =
            [interface, (nanos >> 32) as u32, nanos as u32, data.len() as u32, length as u32];
        let mut body: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        body.extend(data);
        self.block(6, &body);
        self
    }

    /// A packet without a time.
    pub fn simple(mut self, data: &[u8]) -> Self {
        let body = [&(data.len() as u32).to_le_bytes()[..], data].concat();
        self.block(3, &body);
        self
    }
}

/// A packet of SocketCAN.
pub fn can(id: u32, data: &[u8]) -> Vec<u8> {
    [&id.to_be_bytes()[..], &[data.len() as u8, 0, 0, 0], data].concat()
}

/// A packet of bytes that came in on a serial line.
pub fn serial(data: &[u8]) -> Vec<u8> {
    [&[0; 8][..], &[2, 0, 0, 0], data].concat()
}

/// An MDF 4 file with bus logging.
pub struct Mdf(pub Vec<u8>);

impl Mdf {
    pub fn new() -> Self {
        let mut bytes = b"MDF     4.11    test    ".to_vec();
        bytes.resize(64 + 104, 0);
        bytes[28..30].copy_from_slice(&411_u16.to_le_bytes());
        Self(bytes)
    }

    /// Adds a block; its address.
    pub fn add(&mut self, id: &[u8; 4], links: &[u64], data: &[u8]) -> u64 {
        self.0.resize(self.0.len().next_multiple_of(8), 0);
        let at = self.0.len() as u64;
        self.put(id, links, data);
        at
    }

    fn put(&mut self, id: &[u8; 4], links: &[u64], data: &[u8]) {
        let length = (24 + 8 * links.len() + data.len()) as u64;
        self.0.extend(id);
        self.0.extend([0; 4]);
        self.0.extend(length.to_le_bytes());
        self.0.extend((links.len() as u64).to_le_bytes());
        self.0.extend(links.iter().flat_map(|link| link.to_le_bytes()));
        self.0.extend(data);
    }

    /// A channel in front of `next`: its name, what it is for (0 value, 2 time), type of data, byte
    /// and bits.
    pub fn channel(&mut self, next: u64, name: &str, about: (u8, u8, u32, u32)) -> u64 {
        let (role, kind, byte, bits) = about;
        let name = self.add(b"##TX", &[], format!("{name}\0").as_bytes());
        let mut data = vec![role, 0, kind, 0];
        data.extend([byte, bits, 0].iter().flat_map(|number: &u32| number.to_le_bytes()));
        data.resize(72, 0);
        self.add(b"##CN", &[next, 0, name, 0, 0, 0, 0, 0], &data)
    }

    /// Puts the header in, with the first data group.
    pub fn finish(mut self, group: u64) -> Vec<u8> {
        let rest = self.0.split_off(64 + 104);
        self.0.truncate(64);
        let mut data = 1_700_000_000_000_000_000_u64.to_le_bytes().to_vec();
        data.resize(32, 0);
        self.put(b"##HD", &[group, 0, 0, 0, 0, 0], &data);
        [self.0, rest].concat()
    }
}
