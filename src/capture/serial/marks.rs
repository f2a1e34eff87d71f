//! Takes the kernel's error marks (PARMRK, termios(3)) out of the bytes of a tty.

use crate::frame::{LineError, LineErrorKind};

const MARK: u8 = 0xFF;

/// Undoes what PARMRK does: FF FF is a byte FF, FF 00 x a byte x with a parity or framing error,
/// FF 00 00 a break. Marks may be cut anywhere by reads.
///
/// A break leaves the byte 00 behind, as it would without marks, so the data are what any other
/// program would have read. A zero byte with a parity error looks like a break: the kernel makes
/// no difference.
#[derive(Clone, Debug)]
pub struct Unmarker {
    state: State,
    /// What a marked byte means on this line.
    bad_byte: LineErrorKind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Plain,
    /// After FF.
    Marked,
    /// After FF 00.
    Bad,
}

impl Unmarker {
    /// For a line with or without a parity bit. Without one, a marked byte can only be a framing
    /// error.
    pub fn new(parity: bool) -> Self {
        let bad_byte = if parity { LineErrorKind::ParityOrFraming } else { LineErrorKind::Framing };
        Self { state: State::Plain, bad_byte }
    }

    /// Appends the bytes in `marked` to `data` and what was wrong with them to `errors`.
    ///
    /// A mark that is not complete yet waits for the next call, and its byte with it.
    pub fn feed(&mut self, mut marked: &[u8], data: &mut Vec<u8>, errors: &mut Vec<LineError>) {
        while let Some((&first, rest)) = marked.split_first() {
            match self.state {
                State::Plain => {
                    let plain = marked.iter().position(|&b| b == MARK).unwrap_or(marked.len());
                    data.extend_from_slice(&marked[..plain]);
                    marked = &marked[plain..];
                    if !marked.is_empty() {
                        self.state = State::Marked;
                        marked = &marked[1..];
                    }
                    continue;
                }
                State::Marked if first == 0 => self.state = State::Bad,
                State::Marked => {
                    // The kernel doubles FF. Should a driver not, both bytes are kept.
                    if first != MARK {
                        data.push(MARK);
                    }
                    data.push(first);
                    self.state = State::Plain;
                }
                State::Bad => {
                    let kind = if first == 0 { LineErrorKind::Break } else { self.bad_byte };
                    let offset = u32::try_from(data.len()).unwrap_or(u32::MAX);
                    errors.push(LineError { offset, kind });
                    data.push(first);
                    self.state = State::Plain;
                }
            }
            marked = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unmark(reads: &[&[u8]]) -> (Vec<u8>, Vec<(u32, LineErrorKind)>) {
        let mut unmarker = Unmarker::new(true);
        let (mut all, mut wrong) = (Vec::new(), Vec::new());
        for read in reads {
            let (mut data, mut errors) = (Vec::new(), Vec::new());
            unmarker.feed(read, &mut data, &mut errors);
            let before = all.len() as u32;
            assert!(errors.iter().all(|e| (e.offset as usize) < data.len()));
            wrong.extend(errors.iter().map(|e| (before + e.offset, e.kind)));
            all.extend(data);
        }
        (all, wrong)
    }

    #[test]
    fn marks_become_errors_at_the_byte_they_belong_to() {
        use LineErrorKind::{Break, Framing, ParityOrFraming};
        let (data, errors) = unmark(&[b"ab\xFF\x00c\xFF\xFF\xFF\x00\x00d\xFF\x00\xFF"]);
        assert_eq!(data, b"abc\xFF\x00d\xFF");
        assert_eq!(errors, [(2, ParityOrFraming), (4, Break), (6, ParityOrFraming)]);

        let mut errors = Vec::new();
        Unmarker::new(false).feed(b"\xFF\x00x", &mut Vec::new(), &mut errors);
        assert_eq!(errors, [LineError { offset: 0, kind: Framing }]);
    }

    /// One character on the line, and what the kernel makes of it.
    fn character() -> impl Strategy<Value = (u8, bool)> {
        (prop_oneof![Just(0xFF), Just(0), any::<u8>()], prop::bool::weighted(0.3))
    }

    proptest! {
        #[test]
        fn what_the_kernel_marked_is_found_again_however_reads_cut_it(
            line in prop::collection::vec(character(), 0..200),
            cuts in prop::collection::vec(1_usize..7, 1..50),
        ) {
            let mut marked = Vec::new();
            for &(byte, bad) in &line {
                match (byte, bad) {
                    (byte, true) => marked.extend([0xFF, 0, byte]),
                    (0xFF, false) => marked.extend([0xFF, 0xFF]),
                    (byte, false) => marked.push(byte),
                }
            }
            let (mut reads, mut rest, mut cut) = (Vec::new(), &marked[..], cuts.iter().cycle());
            while !rest.is_empty() {
                let (read, after) = rest.split_at(rest.len().min(*cut.next().unwrap()));
                reads.push(read);
                rest = after;
            }
            let (data, errors) = unmark(&reads);
            prop_assert_eq!(&data, &line.iter().map(|c| c.0).collect::<Vec<_>>());
            let bad: Vec<u32> = (0..).zip(&line).filter(|(_, c)| c.1).map(|(i, _)| i).collect();
            prop_assert_eq!(errors.iter().map(|e| e.0).collect::<Vec<_>>(), bad);
            for (at, kind) in errors {
                prop_assert_eq!(kind == LineErrorKind::Break, data[at as usize] == 0);
            }
        }

        #[test]
        fn any_bytes_at_all_are_taken(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let (data, _) = unmark(&[&bytes]);
            prop_assert!(data.len() <= bytes.len());
        }
    }
}
