//! Identifiers of SAE J1939 (J1939-21, "Protocol Data Unit").

/// A 29-bit identifier, taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identifier {
    /// 0 (highest) to 7.
    pub priority: u8,
    /// Parameter group number, 18 bits.
    pub pgn: u32,
    /// Address of the sender.
    pub source: u8,
    /// Address of the receiver; `None` when everybody is meant (PDU2). 255 is everybody, too.
    pub destination: Option<u8>,
}

impl Identifier {
    /// Takes `id` apart.
    pub fn of(id: u32) -> Self {
        let [source, specific, format, top] = id.to_le_bytes();
        let page = u32::from(top & 0x03) << 16 | u32::from(format) << 8;
        // PDU1: the lower byte is an address, not part of the number.
        let addressed = format < 240;
        Self {
            priority: (top >> 2) & 7,
            pgn: if addressed { page } else { page | u32::from(specific) },
            source,
            destination: addressed.then_some(specific),
        }
    }
}
