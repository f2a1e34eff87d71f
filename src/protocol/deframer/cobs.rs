//! Consistent overhead byte stuffing (Cheshire and Baker, 1997).

/// Appends `bytes` without a zero among them; the zero behind is not appended.
pub fn encode(bytes: &[u8], out: &mut Vec<u8>) {
    for block in bytes.split(|byte| *byte == 0) {
        let mut full = block.chunks_exact(254);
        for run in &mut full {
            out.push(0xFF);
            out.extend_from_slice(run);
        }
        let rest = full.remainder();
        out.push(rest.len().to_le_bytes()[0] + 1);
        out.extend_from_slice(rest);
    }
}

/// What stood between two zeros, decoded; `None` when it is not COBS.
pub fn decode(mut encoded: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::with_capacity(encoded.len());
    while let Some((code, rest)) = encoded.split_first() {
        let block = usize::from(*code).checked_sub(1)?;
        let (block, rest) = rest.split_at_checked(block)?;
        bytes.extend_from_slice(block);
        // A zero stands behind every block but the last; one of 254 bytes has none.
        if *code != 0xFF && !rest.is_empty() {
            bytes.push(0);
        }
        encoded = rest;
    }
    Some(bytes)
}
