//! A replay that is told what to do while it runs: by commands, keys and signals.

use std::fs::OpenOptions;
use std::io::{Read as _, Write as _};

use bustape::frame::Direction;
use bustape::recording::writer::Layout;
use nix::sys::signal::Signal;
use nix::sys::termios::LocalFlags;

use super::{MILLI, Made, lines, serial};
use crate::support::make::{START, at};
use crate::support::person::Person;
use crate::support::process::{args, spawn, start};
use crate::support::terminal::open;
use crate::support::until;

#[test]
fn a_replay_is_paused_stepped_sought_and_marked_by_a_script() {
    let pieces: Vec<_> =
        (0..100u64).map(|n| (1, at(n * 100 * MILLI, serial(Direction::Rx, &[n as u8])))).collect();
    let made = Made::new(Layout::Batch, &pieces);
    let (tty, fifo) = (made.path("tty"), made.path("fifo"));
    nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).unwrap();
    let running = start(args(&[
        &"replay",
        &made.file,
        &"--to",
        &format!("line=pty:{}", tty.display()),
        &"--json",
        &"--paused",
        &"--control",
        &fifo,
    ]));
    let mut terminal = open(&tty);
    let say = |text: &str| {
        // One script after the other, as `echo >fifo` does it.
        let mut script = OpenOptions::new().write(true).open(&fifo).unwrap();
        writeln!(script, "{text}").unwrap();
    };
    let mut next = |count: usize| {
        let mut bytes = vec![0; count];
        terminal.read_exact(&mut bytes).unwrap();
        bytes
    };
    say("step");
    assert_eq!(next(1), [0]);
    say("step 2\nnonsense\nmark here");
    assert_eq!(next(2), [1, 2]);
    say("seek +5s\nstep");
    assert_eq!(next(1), [50]);
    say("back 2s\nstep");
    assert_eq!(next(1), [30]);
    say("forward 6s\nrate 100\nresume");
    assert_eq!(next(10), (90..100).collect::<Vec<u8>>());
    let ran = running.wait().expect(0);
    let report = ran.json();
    assert_eq!(report["marks"][0]["text"], "here");
    assert_eq!(report["marks"][0]["time_ns"], START + 200 * MILLI);
    assert!(ran.err.contains("\"nonsense\" is no command"), "{}", ran.err);
}

#[test]
fn the_last_command_of_a_script_needs_no_end_of_line() {
    let made = Made::new(Layout::Frame, &[(1, at(0, serial(Direction::Rx, b"a")))]);
    // Behind the end of the recording there is nothing to go to, and nothing to wait for.
    for (script, said) in [("quit", "\"reason\":\"quit\""), ("seek +90s", "now at +0.000 s")] {
        let mut command = std::process::Command::new("sh");
        let replay = format!(
            "printf '{script}' | {} replay {} --to line=trace: --paused --control - --json",
            crate::support::process::BUSTAPE,
            made.file.display()
        );
        command.args(["-c", &replay]);
        let ran = spawn(command).wait().expect(0);
        assert!(ran.err.contains(said), "{}", ran.err);
    }
}

#[test]
fn a_signal_ends_a_replay_at_once_and_leaves_nothing_behind() {
    let made = Made::new(
        Layout::Frame,
        &[
            (1, at(0, serial(Direction::Rx, b"a"))),
            (1, at(3_600_000 * MILLI, serial(Direction::Rx, b"b"))),
        ],
    );
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    for signal in [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP] {
        let running = start(args(&[&"replay", &made.file, &"--to", &to, &"--json"]));
        until("the terminal", || tty.exists().then_some(()));
        running.signal(signal);
        let ran = running.wait().expect(0);
        assert_eq!(ran.json()["reason"], signal.as_str());
        assert!(std::fs::symlink_metadata(&tty).is_err(), "the link stays behind");
    }
    // Long pauses can be shortened instead.
    let ran = made.replay(&["--to", "line=trace:", "--max-gap", "5ms"]).expect(0);
    assert_eq!(lines(&ran.out).len(), 2);
}

#[test]
fn keys_pause_step_seek_hasten_mark_and_quit_and_the_terminal_is_as_before() {
    let pieces: Vec<_> =
        (0..200u64).map(|n| (1, at(n * 100 * MILLI, serial(Direction::Rx, &[n as u8])))).collect();
    let made = Made::new(Layout::Frame, &pieces);
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    let mut person = Person::start(args(&[&"replay", &made.file, &"--to", &to, &"--paused"]));
    person.sees("space pause, . step");
    let mut terminal = open(&tty);
    let mut next = || {
        let mut byte = [0];
        terminal.read_exact(&mut byte).unwrap();
        byte[0]
    };
    assert!(!person.mode().local_flags.intersects(LocalFlags::ECHO | LocalFlags::ICANON));
    // The line that tells how things go.
    person.sees("paused 0 ms of 19.900 s  rate 1x  0 sent");
    person.press(".");
    assert_eq!(next(), 0);
    person.press("..");
    assert_eq!((next(), next()), (1, 2));
    person.press("\x1b[C");
    person.sees("now at +5.200 s");
    person.press(".");
    assert_eq!(next(), 52);
    person.press("\x1b[D.");
    person.sees("now at +0.200 s");
    assert_eq!(next(), 2);
    person.press("++");
    person.sees("rate 2x");
    person.sees("rate 4x");
    person.press("-");
    person.sees("rate 2x");
    person.press("m");
    person.sees("mark: +0.200 s");
    // Nothing was played that was not asked for, and now it goes on by itself.
    person.press(" ");
    person.sees("playing at +0.200 s");
    assert_eq!((next(), next()), (3, 4));
    person.press(" ");
    person.sees("paused at");
    person.press("xq");
    let (code, out) = person.wait();
    assert!(code == Some(0) && out.contains("quit after"), "{out}");
    assert!(person.mode() == person.before, "the terminal is another");
}

#[test]
fn a_terminal_is_as_before_after_signals_and_keys_that_are_signals() {
    let made = Made::new(
        Layout::Frame,
        &[
            (1, at(0, serial(Direction::Rx, b"a"))),
            (1, at(3_600_000 * MILLI, serial(Direction::Rx, b"b"))),
        ],
    );
    let tty = made.path("tty");
    let to = format!("line=pty:{}", tty.display());
    for by_key in [false, true] {
        let mut person = Person::start(args(&[&"replay", &made.file, &"--to", &to]));
        person.sees("space pause");
        person.sees("playing");
        assert!(person.mode() != person.before);
        if by_key {
            person.press("\x03");
        } else {
            person.signal(Signal::SIGTERM);
        }
        let (code, out) = person.wait();
        let reason = if by_key { "SIGINT after" } else { "SIGTERM after" };
        assert!(code == Some(0) && out.contains(reason), "{out}");
        assert!(person.mode() == person.before, "the terminal is another");
        assert!(std::fs::symlink_metadata(&tty).is_err(), "the link stays behind");
    }
}
