//! A device that is unplugged and comes back, again and again.

use std::fs::OpenOptions;
use std::os::unix::fs::{OpenOptionsExt as _, symlink};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant, SystemTime};

use super::item::{Found, Item, Job, spread};
use super::kills::start;
use super::runs::{Run, runs};
use crate::floods;
use crate::record::{in_order, weight};
use crate::support::messages::{self, LINK_DOWN};
use crate::support::process::{Running, args};
use crate::support::terminal::Device;
use crate::support::{mcap, until};

/// Cycles of one recorder.
const EACH: u64 = 10;

pub const ITEM: Item = Item {
    name: "unplug",
    promise: "a serial device unplugged for 0 to 3 s, also within a packet: noticed within 100 ms, \
              one gap a cycle that holds the moment, everything that was said before and after recorded, opened \
              again within 1 s of its return, at most 2 % of a core meanwhile",
    count: 100,
    unit: "cycles",
    side_by_side: 5,
    run,
};

pub const FLOODS: Item = Item {
    name: "floods",
    promise: "serial bytes that never become a frame (a line without an end, SLIP escapes and ends, lengths of 4 GiB, \
              no pause), 1 GiB of the first and 128 MiB of each other, decoded meanwhile: every byte recorded, memory \
              grows by less than 32 MiB",
    count: floods::FLOODS.len() as u64,
    unit: "floods",
    side_by_side: 2,
    run: |job| {
        let (mut found, grown) = runs(job, |run| {
            let flood = &floods::FLOODS[run.number as usize % floods::FLOODS.len()];
            let much = if run.number == 0 { (1 << 30, 8 << 20) } else { (128 << 20, floods::RATE) };
            (flood.name, floods::is_recorded(flood, much, run.bustape, run.folder))
        });
        for (name, grown) in grown {
            found.number(name, format!("memory grew by {grown} KiB"));
        }
        found
    },
};

struct Cycle {
    /// From the link's return until the recorder has the port open.
    back: Duration,
    /// From the unplugging until it was noticed.
    late: Duration,
    /// Share of a core while it was away.
    cpu: f64,
}

fn run(job: &Job) -> Found {
    let recorders = Job {
        count: job.count.div_ceil(EACH),
        folder: job.folder.clone(),
        bustape: job.bustape.clone(),
        ..*job
    };
    let (mut found, cycles) = runs(&recorders, one);
    let cycles: Vec<Cycle> = cycles.into_iter().flatten().collect();
    found.done = cycles.len() as u64;
    let millis = |value: fn(&Cycle) -> Duration| -> Vec<f64> {
        cycles.iter().map(|c| value(c).as_secs_f64() * 1e3).collect()
    };
    let (p50, max) = spread(&mut millis(|c| c.back), 0.5);
    found.number("open again after, p50 / max", format!("{p50:.0} / {max:.0} ms"));
    let (p50, max) = spread(&mut millis(|c| c.late), 0.5);
    found.number("noticed after, p50 / max", format!("{p50:.1} / {max:.1} ms"));
    let mut cpu: Vec<f64> = cycles.iter().map(|c| c.cpu * 100.0).collect();
    let (p50, max) = spread(&mut cpu, 0.5);
    found.number(
        "share of a core while away (of 1 s and more), p50 / max",
        format!("{p50:.1} / {max:.1} %"),
    );
    found
}

/// Plugs a device in behind its stable name.
pub fn plug(link: &Path) -> Device {
    let device = Device::new();
    // Raw from the start: what is said before the recorder has set it must not be echoed.
    let port =
        OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOCTTY).open(device.port());
    let port = port.expect("the port");
    let mut settings = nix::sys::termios::tcgetattr(&port).expect("settings");
    nix::sys::termios::cfmakeraw(&mut settings);
    nix::sys::termios::tcsetattr(&port, nix::sys::termios::SetArg::TCSANOW, &settings)
        .expect("settings");
    symlink(device.port(), link).expect("a link");
    device
}

/// Waits until the recorder has the device's port open.
fn until_open(running: &Running, device: &Device) {
    let open = format!("/proc/{}/fd", running.pid());
    until("the port to be opened", || {
        let mut descriptors = std::fs::read_dir(&open).ok()?.flatten();
        let found =
            descriptors.any(|fd| std::fs::read_link(fd.path()).is_ok_and(|to| to == device.port()));
        found.then_some(())
    });
}

fn wall() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as u64
}

/// User and system time so far, milliseconds in steps of ten.
fn cpu(running: &Running) -> u64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", running.pid())).expect("it runs");
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    fields[11..13].iter().map(|field| field.parse::<u64>().unwrap() * 10).sum()
}

fn one(mut run: Run<'_>) -> Vec<Cycle> {
    let (link, path) = (run.folder.join("port"), run.folder.join("a.mcap"));
    let mut device = plug(&link);
    let line = format!("line={},115200", link.display());
    let running = start(run.bustape, args(&[&"record", &line, &"-o", &path, &"--json"]));
    let (mut said, mut cycles, mut unplugged) = (Vec::new(), Vec::new(), Vec::new());
    let part = run.folder.join("a.mcap.part");
    let mut number = 0_u64;
    for cycle in 0..=EACH {
        let plugged = Instant::now();
        if cycle > 0 {
            // Said before the recorder has opened the port again: it must not be missed.
            device.say(b"!");
            said.push(b'!');
        }
        until_open(&running, &device);
        let back = plugged.elapsed();
        if let Some(Cycle { back: place, .. }) = cycles.last_mut() {
            *place = back;
            assert!(back <= Duration::from_secs(1), "cycle {cycle}: open again after {back:?}");
        }
        for _ in 0..1 + run.random.below(20) {
            let bytes = super::feed::record(number);
            number += 1;
            device.say(&bytes);
            said.extend_from_slice(&bytes);
            std::thread::sleep(Duration::from_millis(run.random.below(20) as u64));
        }
        let heard = || {
            let heard = part.exists().then(|| messages::streams(&mcap::cut(&part), "line").0)?;
            Some(heard.len())
        };
        if cycle == EACH {
            until("everything to be heard", || (heard()? == said.len()).then_some(()));
            break;
        }
        // Half a packet, which has been heard when the line is cut.
        device.say(b"half");
        said.extend_from_slice(b"half");
        until("everything to be heard", || (heard()? == said.len()).then_some(()));
        std::fs::remove_file(&link).unwrap();
        drop(device);
        unplugged.push(wall());
        let away = Duration::from_millis(run.random.below(3000) as u64);
        std::thread::sleep(Duration::from_millis(50).min(away));
        let (before, since) = (cpu(&running), Instant::now());
        std::thread::sleep(away.saturating_sub(Duration::from_millis(50)));
        let share = (cpu(&running) - before) as f64 / 1e3 / since.elapsed().as_secs_f64();
        let share = if away >= Duration::from_secs(1) { share } else { 0.0 };
        assert!(share <= 0.02, "cycle {cycle}: {:.1} % of a core while away", share * 100.0);
        cycles.push(Cycle { back: Duration::ZERO, late: Duration::ZERO, cpu: share });
        device = plug(&link);
    }
    // Nobody knows what was missed meanwhile, so the exit status says that something was.
    let ran = running.stop().expect(3);
    let file = mcap::finished(&path);
    in_order(&file, true);
    assert_eq!(weight(&file, "line"), ran.json()["buses"][0]["written"].as_u64().unwrap());
    assert!(messages::streams(&file, "line").0 == said, "not what was said while it was open");
    let gaps: Vec<_> =
        messages::decoded(&file).filter(|(m, _)| file.topic(m) == "/line/gaps").collect();
    assert_eq!(gaps.len(), EACH as usize, "one gap a cycle");
    let away: Vec<u64> = messages::decoded(&file)
        .filter(|(m, log)| file.topic(m) == "/bustape/log" && log.to_string().contains("went away"))
        .map(|(message, _)| message.time)
        .collect();
    assert_eq!(away.len(), EACH as usize, "one sentence a cycle");
    for ((((_, gap), away), unplugged), cycle) in
        gaps.iter().zip(away).zip(unplugged).zip(&mut cycles)
    {
        let gap = messages::as_python(gap);
        assert_eq!((&gap["reason"], &gap["count"]), (&LINK_DOWN.into(), &0.into()), "{gap}");
        let [from, to] = ["from_ns", "to_ns"].map(|key| gap[key].as_u64().unwrap());
        assert!(from <= unplugged && unplugged <= to, "{gap} does not hold {unplugged}");
        cycle.late = Duration::from_nanos(away.saturating_sub(unplugged));
        assert!(cycle.late <= Duration::from_millis(100), "noticed after {:?}", cycle.late);
    }
    cycles
}
