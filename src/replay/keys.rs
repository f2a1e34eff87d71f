//! Single keys from a terminal. Its mode is restored when this is dropped.

use std::fs::File;
use std::io::{self, Read as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use nix::sys::signal::{SigSet, Signal};
use nix::sys::termios::{
    LocalFlags, SetArg, SpecialCharacterIndices, Termios, tcgetattr, tcsetattr,
};
use nix::unistd::{getpgrp, tcgetpgrp};

use super::control::Request;

/// How far the arrows go.
const LEAP: Duration = Duration::from_secs(5);

/// The keys, for a person.
pub const HELP: &str = "space pause, . step, left/right 5 s, +/- rate, m mark, q quit";

/// A terminal that hands over keys one by one, without showing them. Ctrl-C still is a signal.
pub struct Keys {
    terminal: File,
    before: Termios,
    /// Bytes of an arrow key that is not complete yet.
    held: Vec<u8>,
    /// No more keys come: the terminal hung up, or belongs to another program now.
    gone: bool,
}

impl Keys {
    /// Takes over the terminal that is stdin.
    ///
    /// # Errors
    /// Where stdin is no terminal, or one that another program is using (we run behind an `&`).
    pub fn new() -> io::Result<Self> {
        let terminal: File = io::stdin().as_fd().try_clone_to_owned()?.into();
        let before = tcgetattr(&terminal)?;
        if !is_ours(&terminal) {
            return Err(io::Error::other("the terminal belongs to another program"));
        }
        // Should it later be taken away (Ctrl-Z, bg), reading it must fail instead of stopping us.
        let mut set = SigSet::empty();
        set.add(Signal::SIGTTIN);
        set.add(Signal::SIGTTOU);
        set.thread_block()?;
        let mut mode = before.clone();
        mode.local_flags.remove(LocalFlags::ICANON | LocalFlags::ECHO);
        mode.control_chars[SpecialCharacterIndices::VMIN as usize] = 0;
        mode.control_chars[SpecialCharacterIndices::VTIME as usize] = 0;
        tcsetattr(&terminal, SetArg::TCSANOW, &mode)?;
        Ok(Self { terminal, before, held: Vec::new(), gone: false })
    }

    /// What to wait for, as long as keys may come.
    pub fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        (!self.gone).then(|| self.terminal.as_fd())
    }

    /// Takes the keys that were pressed; there are some.
    pub fn read(&mut self, take: &mut dyn FnMut(Request)) {
        let mut buffer = [0; 64];
        match self.terminal.read(&mut buffer) {
            Ok(length @ 1..) => self.held.extend_from_slice(&buffer[..length]),
            Ok(_) => self.gone = true,
            Err(error) => self.gone = error.kind() != io::ErrorKind::Interrupted,
        }
        let held = std::mem::take(&mut self.held);
        self.held = decode(&held, take).to_vec();
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if is_ours(&self.terminal) {
            // A terminal that is gone needs no restoring.
            let _ = tcsetattr(&self.terminal, SetArg::TCSANOW, &self.before);
        }
    }
}

/// False if another program has the terminal now (tcgetpgrp(3)). One that controls nobody is ours.
fn is_ours(terminal: &File) -> bool {
    !tcgetpgrp(terminal).is_ok_and(|group| group != getpgrp())
}

/// Gives what the keys mean to `take`; returns the start of a key that is not complete.
fn decode<'a>(mut keys: &'a [u8], take: &mut dyn FnMut(Request)) -> &'a [u8] {
    loop {
        let (request, length) = match keys {
            [] | [0x1B] | [0x1B, b'['] => return keys,
            [0x1B, b'[', b'C', ..] => (Some(Request::Skip(LEAP, true)), 3),
            [0x1B, b'[', b'D', ..] => (Some(Request::Skip(LEAP, false)), 3),
            [0x1B, b'[', _, ..] => (None, 3),
            [b' ', ..] => (Some(Request::Toggle), 1),
            [b'.', ..] => (Some(Request::Step(1)), 1),
            [b'+', ..] => (Some(Request::Faster(true)), 1),
            [b'-', ..] => (Some(Request::Faster(false)), 1),
            [b'm', ..] => (Some(Request::Mark(String::new())), 1),
            [b'q', ..] => (Some(Request::Quit), 1),
            _ => (None, 1),
        };
        if let Some(request) = request {
            take(request);
        }
        keys = &keys[length..];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_and_arrows_are_told_apart_also_when_they_come_in_parts() {
        let mut asked = Vec::new();
        let left = decode(b" .+-\x1b[C\x1b[Ax\x1b[", &mut |request| asked.push(request));
        assert_eq!(left, b"\x1b[");
        let expected = [
            Request::Toggle,
            Request::Step(1),
            Request::Faster(true),
            Request::Faster(false),
            Request::Skip(LEAP, true),
        ];
        assert_eq!(asked, expected);
        asked.clear();
        assert!(decode(b"\x1b[Dmq", &mut |request| asked.push(request)).is_empty());
        assert_eq!(asked.len(), 3);
        assert_eq!(asked[0], Request::Skip(LEAP, false));
    }
}
