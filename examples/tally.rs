//! Counts the frames and bytes of each bus of a recording: how to read recordings with the library.
//!
//!     tally FILE...

use std::path::PathBuf;

use anyhow::Result;
use bustape::frame::Frame;
use bustape::recording::reader::{Entry, Recording};

fn main() -> Result<()> {
    let files: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let recording = Recording::open(&files)?;
    let mut sums = vec![(0_u64, 0_u64); recording.buses.len()];
    let mut entries = recording.entries(Recording::ALL, |topic| topic.ends_with("/raw"));
    for entry in entries.by_ref() {
        let Entry::Frame(bus, frame) = entry.value else { continue };
        let bytes = match &frame {
            Frame::Can(frame) => frame.data().len(),
            Frame::Serial(bytes) => bytes.data.len(),
            Frame::Gap(_) | Frame::Notice(_) => continue,
        };
        sums[bus].0 += 1;
        sums[bus].1 += bytes as u64;
    }
    for (name, (frames, bytes)) in recording.buses.iter().zip(sums) {
        println!("{name} {frames} {bytes}");
    }
    for sentence in entries.damage() {
        eprintln!("{sentence}");
    }
    Ok(())
}
