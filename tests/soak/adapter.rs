//! A CAN adapter that says numbered frames at a steady rate (Lawicel protocol), as long as it is open.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use crate::support::terminal::Device;

/// Frame number `number`: its identifier and data tell it.
pub fn line(number: u64) -> String {
    format!("t{:03x}8{number:016X}\r", number % 0x7F0)
}

/// Answers what the recorder commands, and says `rate` frames a second while the channel is open. Ends
/// when it is closed for the last time (`stop` is set). Returns how many frames it has said.
pub fn serve(device: &mut Device, rate: u64, stop: &AtomicBool) -> u64 {
    let (mut command, mut opened, mut said) = (Vec::new(), None::<Instant>, 0_u64);
    let mut first = 0;
    loop {
        let mut buffer = [0; 4096];
        while let Ok(length) = device.hear(&mut buffer) {
            for byte in &buffer[..length] {
                if *byte != b'\r' {
                    command.push(*byte);
                    continue;
                }
                match command.first() {
                    Some(b'O' | b'L') => (opened, first) = (Some(Instant::now()), said),
                    Some(b'C') => opened = None,
                    _ => {}
                }
                let answer: &[u8] = match command.first() {
                    Some(b'V') => b"V1013\r",
                    Some(b'F') => b"F00\r",
                    _ => b"\r",
                };
                device.say(answer);
                command.clear();
            }
        }
        if let Some(opened) = opened {
            let due = first + opened.elapsed().as_micros() as u64 * rate / 1_000_000;
            let text: String = (said..due).map(line).collect();
            device.say(text.as_bytes());
            said = said.max(due);
        } else if stop.load(Relaxed) {
            return said;
        }
        std::thread::sleep(Duration::from_millis(4));
    }
}
