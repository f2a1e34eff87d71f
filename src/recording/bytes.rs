//! Records as bytes: opcode, length (u64, little endian), content.

use std::io::{self, Cursor};

use binrw::BinWrite;

/// The content of a record.
pub fn body<T>(record: &T) -> io::Result<Vec<u8>>
where
    for<'a> T: BinWrite<Args<'a> = ()>,
{
    let mut body = Cursor::new(Vec::new());
    record.write_le(&mut body).map_err(io::Error::other)?;
    Ok(body.into_inner())
}

/// A whole record.
pub fn record_bytes<T>(opcode: u8, record: &T) -> io::Result<Vec<u8>>
where
    for<'a> T: BinWrite<Args<'a> = ()>,
{
    let mut bytes = Vec::new();
    put_bytes(&mut bytes, opcode, &body(record)?);
    Ok(bytes)
}

/// Appends a record.
pub fn put<T>(out: &mut Vec<u8>, opcode: u8, record: &T) -> io::Result<()>
where
    for<'a> T: BinWrite<Args<'a> = ()>,
{
    out.extend_from_slice(&record_bytes(opcode, record)?);
    Ok(())
}

/// A record with this content.
pub fn with_head(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut record = Vec::with_capacity(body.len() + 9);
    put_bytes(&mut record, opcode, body);
    record
}

/// Appends a record with this content.
pub fn put_bytes(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend_from_slice(&(body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}
