//! Serial capture, driven through real pseudo-terminals.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::panic_in_result_fn,
    clippy::cast_possible_truncation,
    clippy::large_stack_arrays,
    clippy::naive_bytecount,
    reason = "a test that cannot go on fails by panicking"
)]

mod rig;

use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{OpenOptionsExt, symlink};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use bustape::capture::serial::SerialAddress;
use bustape::frame::{Direction, Frame, GapReason, Unit};
use nix::poll::{PollFd, PollFlags, poll};
use rig::{Device, Recorder, bytes, count_bytes, gaps, noise, notices};

fn record(address: String) -> Recorder {
    Recorder::start(Unit::Bytes, move || {
        SerialAddress::parse(&address).unwrap().unwrap().open().unwrap()
    })
}

/// Opens a terminal as an application does that does not want it as its controlling terminal.
fn application(path: &Path) -> File {
    OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY).open(path).unwrap()
}

/// Reads exactly `count` bytes, or fails instead of waiting for ever.
fn hear(mut application: &File, count: usize) -> Vec<u8> {
    let (mut heard, end) = (vec![0; count], Instant::now() + rig::PATIENCE);
    let mut so_far = 0;
    while so_far < count {
        assert!(Instant::now() < end, "the application heard {so_far} of {count} bytes");
        let mut wait = [PollFd::new(application.as_fd(), PollFlags::POLLIN)];
        if poll(&mut wait, 50_u8).unwrap() > 0 {
            so_far += application.read(&mut heard[so_far..]).unwrap();
        }
    }
    heard
}

const FLOOD: usize = 40 << 20;

#[test]
fn a_flood_into_a_pseudo_terminal_is_recorded_without_losing_a_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tty");
    let recorder = record(format!("pty:{}", path.display()));
    let sent = noise(1, FLOOD);
    let start = Instant::now();
    application(&path).write_all(&sent).unwrap();
    recorder.wait("the whole flood", |f| count_bytes(f, Direction::Rx) == FLOOD);
    let seconds = start.elapsed().as_secs_f64();
    let recorded = recorder.finish();
    assert!(bytes(&recorded.frames, Direction::Rx) == sent);
    assert_eq!(recorded.totals.received, FLOOD as u64);
    assert!(!path.exists() && fs::symlink_metadata(&path).is_err(), "the link stays behind");
    eprintln!("flood: {:.1} MB/s, {:?} CPU", FLOOD as f64 / 1e6 / seconds, recorded.cpu);
}

#[test]
fn a_flood_into_a_port_is_recorded_without_losing_a_byte() {
    let device = Device::new();
    let recorder = record(format!("{},4000000,8N1", device.port()));
    let sent = noise(2, FLOOD);
    device.say(&sent);
    recorder.wait("the whole flood", |f| count_bytes(f, Direction::Rx) == FLOOD);
    let recorded = recorder.finish();
    assert!(bytes(&recorded.frames, Direction::Rx) == sent);
    assert_eq!(gaps(&recorded.frames), []);
}

#[test]
fn what_the_kernel_still_holds_at_the_stop_is_recorded() {
    let device = Device::new();
    let recorder = record(format!("{},115200,8N1", device.port()));
    std::thread::sleep(Duration::from_millis(50));
    device.say(&noise(3, 3000));
    let recorded = recorder.finish();
    assert!(bytes(&recorded.frames, Direction::Rx) == noise(3, 3000));
}

#[test]
fn a_tap_tells_which_side_said_what() {
    let (device, host) = (Device::new(), Device::new());
    let recorder = record(format!("tap:{}+{},9600,8N1", device.port(), host.port()));
    for round in 0..20_u8 {
        host.say(&[round; 5]);
        let asked = (usize::from(round) + 1) * 5;
        recorder.wait("the question", |f| count_bytes(f, Direction::Tx) == asked);
        device.say(&[round; 7]);
        let answered = (usize::from(round) + 1) * 7;
        recorder.wait("the answer", |f| count_bytes(f, Direction::Rx) == answered);
    }
    let frames = recorder.finish().frames;
    assert!(frames.is_sorted_by_key(|f| f.time));
    let order: Vec<_> = frames
        .iter()
        .filter_map(|f| match &f.value {
            Frame::Serial(s) => Some((s.direction, s.data[0])),
            _ => None,
        })
        .collect();
    let expected: Vec<_> = (0..20).flat_map(|r| [(Direction::Tx, r), (Direction::Rx, r)]).collect();
    assert_eq!(order, expected);
}

/// A device behind a bridge, and the path for the application.
fn bridge(folder: &Path) -> (Device, PathBuf, Recorder) {
    let device = Device::new();
    let path = folder.join("app");
    let recorder = record(format!("bridge:{},115200,8N1@{}", device.port(), path.display()));
    (device, path, recorder)
}

#[test]
fn a_dialogue_over_a_bridge_is_untouched_and_recorded_in_its_order() {
    const ROUNDS: usize = 300;
    let folder = tempfile::tempdir().unwrap();
    let (device, path, recorder) = bridge(folder.path());
    let question = |round: usize| noise(round as u64 * 2 + 100, 1 + round * 7 % 200);
    let answer = |round: usize| noise(round as u64 * 2 + 101, 1 + round * 13 % 900);
    let mut application = application(&path);
    let answering = std::thread::spawn(move || {
        for round in 0..ROUNDS {
            assert_eq!(device.hear(question(round).len()), question(round));
            device.say(&answer(round));
        }
        device
    });
    let start = Instant::now();
    for round in 0..ROUNDS {
        application.write_all(&question(round)).unwrap();
        assert!(hear(&application, answer(round).len()) == answer(round), "round {round}");
    }
    let each = start.elapsed() / ROUNDS as u32;
    let _device = answering.join().unwrap();
    let recorded = recorder.finish();
    eprintln!("bridge: {each:?} a round, {:.1} % CPU", recorded.cpu_share() * 100.0);

    let mut turns: Vec<(Direction, Vec<u8>)> = Vec::new();
    for frame in &recorded.frames {
        let Frame::Serial(serial) = &frame.value else { panic!("{frame:?}") };
        match turns.last_mut() {
            Some((direction, data)) if *direction == serial.direction => {
                data.extend_from_slice(&serial.data);
            }
            _ => turns.push((serial.direction, serial.data.clone())),
        }
    }
    let expected: Vec<_> = (0..ROUNDS)
        .flat_map(|r| [(Direction::Tx, question(r)), (Direction::Rx, answer(r))])
        .collect();
    assert!(turns == expected);
    assert!(recorded.frames.is_sorted_by_key(|f| f.time));
}

#[test]
fn a_slow_side_of_a_bridge_loses_nothing() {
    const COUNT: usize = 8 << 20;
    let folder = tempfile::tempdir().unwrap();
    let (device, path, recorder) = bridge(folder.path());
    let application = application(&path);
    let (down, up) = (noise(7, COUNT), noise(8, COUNT));
    std::thread::scope(|threads| {
        // The application writes without reading for a while, then reads in small pieces with
        // pauses; the device likewise. Both directions are full for most of the time.
        let mut writer = application.try_clone().unwrap();
        threads.spawn(move || writer.write_all(&noise(8, COUNT)).unwrap());
        threads.spawn(|| device.say(&noise(7, COUNT)));
        let hearing = threads.spawn(|| {
            std::thread::sleep(Duration::from_millis(700));
            device.hear(COUNT)
        });
        std::thread::sleep(Duration::from_millis(1500));
        let mut heard = Vec::new();
        for index in 0.. {
            if heard.len() == COUNT {
                break;
            }
            heard.extend(hear(&application, 9973.min(COUNT - heard.len())));
            if index % 50 == 0 {
                std::thread::sleep(Duration::from_millis(10));
            }
        }
        assert!(heard == down);
        assert!(hearing.join().unwrap() == up);
    });
    let recorded = recorder.finish();
    assert!(bytes(&recorded.frames, Direction::Rx) == down);
    assert!(bytes(&recorded.frames, Direction::Tx) == up);
    assert_eq!(notices(&recorded.frames), [""; 0]);
}

#[test]
fn an_application_may_leave_and_come_back_and_finds_no_stale_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (device, path, recorder) = bridge(folder.path());
    // Nobody there yet: what the device says is recorded all the same.
    device.say(b"early");
    recorder.wait("the early bytes", |f| count_bytes(f, Direction::Rx) == 5);
    for round in 0..10_u8 {
        let mut application = application(&path);
        application.write_all(&[round; 3]).unwrap();
        assert_eq!(device.hear(3), [round; 3]);
        device.say(&[round; 100]);
        assert_eq!(hear(&application, 60), [round; 60]);
        // 40 bytes stay unread, and more come while nobody is there.
        drop(application);
        std::thread::sleep(Duration::from_millis(30));
        device.say(&[0xEE; 50]);
        let so_far = 5 + 150 * (usize::from(round) + 1);
        recorder.wait("bytes of this round", |f| count_bytes(f, Direction::Rx) == so_far);
    }
    let recorded = recorder.finish();
    assert_eq!(recorded.result, Ok(()));
    assert_eq!(count_bytes(&recorded.frames, Direction::Tx), 30);
    // Looking who is left costs a walk through /proc at each leaving; a hang-up that is answered
    // by spinning would cost everything.
    assert!(recorded.cpu_share() < 0.3, "{:?} of {:?}", recorded.cpu, recorded.wall);
}

#[test]
fn an_application_that_stops_reading_does_not_stop_the_recording() {
    const COUNT: usize = 3 << 20;
    let folder = tempfile::tempdir().unwrap();
    let (device, path, recorder) = bridge(folder.path());
    let application = application(&path);
    let sent = noise(9, COUNT);
    device.say(&sent);
    recorder.wait("everything recorded", |f| count_bytes(f, Direction::Rx) == COUNT);
    // It reads a little. As long as it has not caught up, it holds nothing up either.
    let mut heard = hear(&application, 30_000);
    let start = Instant::now();
    let more = noise(10, 200_000);
    device.say(&more);
    recorder.wait("more recorded", |f| count_bytes(f, Direction::Rx) == COUNT + more.len());
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    // It catches up: what was kept for it has no hole, and then comes what is new.
    recorder.wait("the end of the stall", |f| {
        let mut piece = [0; 4096];
        let mut wait = [PollFd::new(application.as_fd(), PollFlags::POLLIN)];
        while poll(&mut wait, 20_u8).unwrap() > 0 {
            let count = (&application).read(&mut piece).unwrap();
            heard.extend_from_slice(&piece[..count]);
        }
        notices(f).iter().any(|n| n.contains("reads again"))
    });
    assert!(heard.len() > 64 << 10 && heard == sent[..heard.len()]);
    device.say(b"fresh");
    assert_eq!(hear(&application, 5), b"fresh");
    let sent = [&sent[..], &more[..], b"fresh"].concat();
    let recorded = recorder.finish();
    assert!(bytes(&recorded.frames, Direction::Rx) == sent);
    let notices = notices(&recorded.frames);
    assert!(notices.iter().any(|n| n.contains("has read nothing for 5 s")), "{notices:?}");
}

/// A device that can be unplugged: its port is found under a stable link.
fn plug(link: &Path) -> Device {
    let device = Device::new();
    symlink(device.port(), link).unwrap();
    device
}

fn unplug(device: Device, link: &Path) {
    fs::remove_file(link).unwrap();
    drop(device);
}

#[test]
fn a_device_that_is_unplugged_leaves_one_gap_and_is_heard_again_within_a_second() {
    const CYCLES: usize = 20;
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("ttyUSB0");
    let mut device = plug(&link);
    let recorder = record(format!("{},9600,8N1", link.display()));
    let mut expected = Vec::new();
    let mut longest = Duration::ZERO;
    for cycle in 0..CYCLES {
        let text = format!("cycle {cycle};");
        device.say(text.as_bytes());
        expected.extend(text.bytes());
        let count = expected.len();
        recorder.wait("its bytes", |f| count_bytes(f, Direction::Rx) == count);
        unplug(device, &link);
        std::thread::sleep(Duration::from_millis(37 * (cycle as u64 % 8)));
        device = plug(&link);
        let start = Instant::now();
        // Said at once, before the recorder has opened the port again: it must not be missed.
        device.say(b"!");
        expected.push(b'!');
        recorder.wait("the return", |f| count_bytes(f, Direction::Rx) == count + 1);
        longest = longest.max(start.elapsed());
    }
    let recorded = recorder.finish();
    assert_eq!(recorded.result, Ok(()));
    assert_eq!(bytes(&recorded.frames, Direction::Rx), expected);
    let gaps = gaps(&recorded.frames);
    assert_eq!(gaps.len(), CYCLES);
    assert!(gaps.iter().all(|g| g.reason == GapReason::LinkDown && g.count == 0 && g.from < g.to));
    assert!(gaps.windows(2).all(|pair| pair[0].to <= pair[1].from));
    assert!(recorded.frames.is_sorted_by_key(|f| f.time));
    assert!(longest < Duration::from_secs(1), "{longest:?}");
    assert!(recorded.cpu_share() < 0.05, "{:.1} %", recorded.cpu_share() * 100.0);
    eprintln!("unplug: back within {longest:?}, {:.2} % CPU", recorded.cpu_share() * 100.0);
}

#[test]
fn while_a_device_is_away_the_recorder_sleeps_and_a_stop_still_writes_the_gap() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("ttyUSB0");
    let device = plug(&link);
    let recorder = record(format!("{},9600,8N1", link.display()));
    device.say(b"x");
    recorder.wait("its byte", |f| count_bytes(f, Direction::Rx) == 1);
    unplug(device, &link);
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(gaps(&recorder.taken.lock().unwrap()), [], "the outage is not over");
    let stopping = Instant::now();
    let recorded = recorder.finish();
    assert!(stopping.elapsed() < Duration::from_millis(100));
    let gaps = gaps(&recorded.frames);
    assert_eq!(gaps.len(), 1);
    assert!(gaps[0].to.since(gaps[0].from) >= 2_000_000_000);
    assert!(recorded.cpu_share() < 0.02, "{:.1} %", recorded.cpu_share() * 100.0);
}

#[test]
fn a_bridge_keeps_the_application_while_the_port_is_away() {
    let folder = tempfile::tempdir().unwrap();
    let (link, path) = (folder.path().join("ttyUSB0"), folder.path().join("app"));
    let device = plug(&link);
    let recorder = record(format!("bridge:{},9600,8N1@{}", link.display(), path.display()));
    let mut application = application(&path);
    application.write_all(b"one").unwrap();
    assert_eq!(device.hear(3), b"one");
    // More than the kernel holds for a device that does not listen: the rest waits in the bridge.
    application.write_all(&[b'.'; 50_000]).unwrap();
    recorder.wait("the waiting bytes", |f| count_bytes(f, Direction::Tx) == 50_003);
    unplug(device, &link);
    recorder.wait("the outage", |f| notices(f).len() == 1);
    application.write_all(b"lost").unwrap();
    recorder.wait("bytes without a port", |f| count_bytes(f, Direction::Tx) == 50_007);
    let device = plug(&link);
    recorder.wait("the return", |f| gaps(f).len() == 1);
    application.write_all(b"two").unwrap();
    assert_eq!(device.hear(3), b"two", "nothing old may be sent late");
    device.say(b"back");
    assert_eq!(hear(&application, 4), b"back");
    let recorded = recorder.finish();
    let notices = notices(&recorded.frames);
    assert!(notices.iter().any(|n| n.contains(" bytes that the application wrote")), "{notices:?}");
}

#[test]
fn the_kernel_marks_and_the_decoder_takes_the_marks_out_again() {
    use bustape::capture::serial::marks::Unmarker;
    let device = Device::new();
    let tty = bustape::sys::tty::Tty::open(&serialport::new(device.port(), 9600)).unwrap();
    tty.mark_errors().unwrap();
    let sent: Vec<u8> = noise(5, 500).into_iter().chain([0xFF, 0xFF, 0, 0, 0xFF]).collect();
    device.say(&sent);
    let (mut data, mut errors) = (Vec::new(), Vec::new());
    let (mut unmarker, mut raw) = (Unmarker::new(false), 0);
    let end = Instant::now() + rig::PATIENCE;
    while data.len() < sent.len() && Instant::now() < end {
        let mut buffer = [0; 7];
        if let Ok(count) = tty.read(&mut buffer) {
            raw += count;
            unmarker.feed(&buffer[..count], &mut data, &mut errors);
        }
    }
    assert!(data == sent && errors.is_empty());
    assert_eq!(raw, sent.len() + sent.iter().filter(|&&b| b == 0xFF).count());
}

#[test]
fn four_megabaud_costs_little() {
    // 400,000 bytes/s in pieces of 62 bytes, as a USB bridge hands them over.
    let device = Device::new();
    let recorder = record(format!("{},4000000,8N1", device.port()));
    let start = Instant::now();
    let mut sent = 0;
    while start.elapsed() < Duration::from_secs(2) {
        let due = (start.elapsed().as_secs_f64() * 400_000.0) as usize;
        while sent < due {
            device.say(&[0x55; 62]);
            sent += 62;
        }
        std::thread::sleep(Duration::from_micros(100));
    }
    recorder.wait("all of it", |f| count_bytes(f, Direction::Rx) == sent);
    let recorded = recorder.finish();
    let reads = recorded.frames.len();
    let share = recorded.cpu_share() * 100.0;
    eprintln!("4 Mbaud: {reads} reads of {sent} bytes, {share:.1} % CPU");
    // A loose bound for a busy machine; what must not happen is a wake-up for every byte.
    assert!(reads <= sent / 31, "{reads} reads of {sent} bytes");
    assert!(share < 50.0, "{share:.1} %");
}
