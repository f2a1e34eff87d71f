//! Stand-in.
use crate::frame::*;
use crate::import::*;
use std::io::BufRead;
pub struct Quick(std::io::BufReader<std::fs::File>, Vec<String>, Skipped);
pub fn open(path: &std::path::Path) -> anyhow::Result<Box<dyn LogReader>> {
    Ok(Box::new(Quick(std::io::BufReader::with_capacity(1<<16, std::fs::File::open(path)?), vec!["can0".into()], Skipped::default())))
}
fn hex(b: u8) -> u8 { match b { b'0'..=b'9' => b - b'0', b'A'..=b'F' => b - b'A' + 10, _ => b.wrapping_sub(b'a') + 10 } }
impl LogReader for Quick {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let mut line = Vec::new();
        for _ in 0..1024 {
            line.clear();
            if self.0.read_until(b'\n', &mut line)? == 0 { return Ok(false); }
            let l = line.trim_ascii_end();
            let (mut t, mut p) = (0u64, 1);
            while l[p] != b')' { if l[p] != b'.' { t = t * 10 + u64::from(l[p] - b'0'); } p += 1; }
            p += 2;
            while l[p] != b' ' { p += 1; }
            p += 1;
            let s = p;
            let mut id = 0u32;
            while l[p] != b'#' { id = id << 4 | u32::from(hex(l[p])); p += 1; }
            let flags = if p - s == 8 { CanFlags::EXTENDED } else { CanFlags::default() };
            let mut d = [0u8; 64]; let mut k = 0; p += 1;
            while p + 1 < l.len() { d[k] = hex(l[p]) << 4 | hex(l[p + 1]); k += 1; p += 2; }
            into.push(LogFrame { bus: 0, frame: Stamped { time: Timestamp(t * 1000), value: Frame::Can(CanFrame::new(id, flags, &d[..k])) } });
        }
        Ok(true)
    }
    fn buses(&self) -> &[String] { &self.1 }
    fn skipped(&self) -> &Skipped { &self.2 }
}
