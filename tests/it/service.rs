//! The recorder as a service: what it tells systemd and the journal, and what a package has of it.

use std::fs::File;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use nix::sys::signal::Signal;

use crate::support::process::{BUSTAPE, Running, args, bustape, spawn, start_injected};
use crate::support::{mcap, messages, until};

/// A recorder whose service manager is `manager`, under `strace` if there are options for it.
fn serve(folder: &Path, manager: &str, strace: &[&str]) -> Running {
    let mut command = Command::new(if strace.is_empty() { BUSTAPE } else { "strace" });
    if !strace.is_empty() {
        command.args(["-D", "-f", "-qqq", "-o", "/dev/null"]).args(strace).arg(BUSTAPE);
    }
    command.args(args(&[&"record", &"sim:hmi-can", &"-d", &folder, &"--sync", &"100ms"]));
    command.env("RUNTIME_DIRECTORY", folder).env("NOTIFY_SOCKET", manager);
    command.env("WATCHDOG_USEC", "900000");
    spawn(command)
}

fn next(socket: &UnixDatagram) -> Option<String> {
    let mut bytes = [0; 4096];
    let length = socket.recv(&mut bytes).ok()?;
    Some(String::from_utf8(bytes[..length].to_vec()).unwrap())
}

/// Waits for a message that begins so.
fn hears(socket: &UnixDatagram, start: &str) -> String {
    until(start, || next(socket).filter(|text| text.starts_with(start)))
}

fn manager(path: &Path) -> UnixDatagram {
    let socket = UnixDatagram::bind(path).unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    socket
}

#[test]
fn the_service_manager_hears_ready_the_state_signs_of_life_and_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = manager(&path);
    let running = serve(folder.path(), path.to_str().unwrap(), &[]);
    assert_eq!(next_of(&socket), "READY=1");
    let files = std::fs::read_dir(folder.path()).unwrap();
    let open = files
        .filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|end| end == "part"));
    assert_eq!(open.count(), 1, "ready means that the file is there");
    let status = hears(&socket, "STATUS=");
    assert!(status.contains("1 buses") && status.contains("0 dropped"), "{status}");
    hears(&socket, "WATCHDOG=1");
    hears(&socket, "WATCHDOG=1");
    running.signal(Signal::SIGTERM);
    hears(&socket, "STOPPING=1");
    running.wait().expect(0);
}

fn next_of(socket: &UnixDatagram) -> String {
    until("a message", || next(socket))
}

#[test]
fn a_manager_in_the_abstract_namespace_is_found_too() {
    let folder = tempfile::tempdir().unwrap();
    let name = format!("bustape-test-{}", std::process::id());
    let address = SocketAddr::from_abstract_name(&name).unwrap();
    let socket = UnixDatagram::bind_addr(&address).unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let running = serve(folder.path(), &format!("@{name}"), &[]);
    assert_eq!(next_of(&socket), "READY=1");
    running.stop().expect(0);
}

#[test]
fn a_hanging_disk_ends_the_signs_of_life_although_capture_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = manager(&path);
    // From the 8th sync on each takes 8 s.
    let slow = ["-e", "trace=fdatasync", "-e", "inject=fdatasync:delay_enter=8000000:when=8+"];
    let running = serve(folder.path(), path.to_str().unwrap(), &slow);
    hears(&socket, "READY=1");
    hears(&socket, "WATCHDOG=1");
    // Three times the interval at which it shall be heard, in which capture still tells its state.
    let mut silent = Vec::new();
    until("silence", || {
        match next(&socket) {
            Some(text) if text == "WATCHDOG=1" => silent.clear(),
            Some(_) => {}
            None => silent.push(()),
        }
        (silent.len() >= 27).then_some(())
    });
    running.kill();
}

#[test]
fn a_disk_that_does_not_answer_is_told_and_stands_in_the_file_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let slow = ["trace=fdatasync", "inject=fdatasync:delay_enter=6000000:when=3"];
    let options = args(&[&"record", &"sim:hmi-can", &"-o", &path, &"--sync", &"100ms"]);
    let running = start_injected(&slow, &[], options);
    let part = folder.path().join("a.mcap.part");
    let said = "the disk did not answer for ";
    until("the sentence in the file", || {
        let file = part.exists().then(|| mcap::cut(&part))?;
        messages::decoded(&file).any(|(_, m)| format!("{m:?}").contains(said)).then_some(())
    });
    let ran = running.stop().expect(0);
    assert_eq!(ran.err.matches("the disk has not answered for ").count(), 1, "{}", ran.err);
    assert!(ran.err.contains(said), "{}", ran.err);
}

#[test]
fn the_journal_gets_levels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let says = |stream: &str| {
        let file = File::create(&path).unwrap();
        let about = file.metadata().unwrap();
        let stream = stream.replace("THIS", &format!("{}:{}", about.dev(), about.ino()));
        let mut command = Command::new(BUSTAPE);
        command.args(["info", "/nowhere.mcap"]).env("JOURNAL_STREAM", stream);
        command.stdout(Stdio::null()).stderr(file);
        assert_eq!(command.status().unwrap().code(), Some(1));
        std::fs::read_to_string(&path).unwrap()
    };
    assert!(says("THIS").starts_with("<3>"), "{}", says("THIS"));
    assert!(says("8:1").starts_with("error"), "{}", says("8:1"));
}

#[test]
fn manual_pages_and_completions_are_made_of_the_same_definitions_as_the_help() {
    let folder = tempfile::tempdir().unwrap();
    bustape(args(&[&"man", &folder.path()])).expect(0);
    let page = std::fs::read_to_string(folder.path().join("bustape-record.1")).unwrap();
    assert!(page.contains("keep\\-size") && page.contains("UTC"), "{page}");
    assert!(folder.path().join("bustape.1").is_file());
    for shell in ["bash", "zsh", "fish"] {
        let script = bustape(["completions", shell]).expect(0).out;
        assert!(script.contains("keep-size") && script.contains("mark"), "{shell}");
    }
}

#[test]
fn the_shipped_configuration_is_sound_and_the_package_finds_what_it_packs() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = root.join("packaging/bustape.toml");
    let printed = bustape(args(&[&"record", &"--config", &file, &"--print-config"])).expect(0).out;
    let said: toml::Table = printed.parse().unwrap();
    assert_eq!(said["dir"].as_str(), Some("/var/lib/bustape"));
    let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
    let manifest: toml::Table = manifest.parse().unwrap();
    let assets = manifest["package"]["metadata"]["deb"]["assets"].as_array().unwrap();
    for asset in assets {
        let path = asset[0].as_str().unwrap();
        let made = path.starts_with("target/");
        let folder = root.join(path.rsplit_once('/').map_or("", |(folder, _)| folder));
        let there = if path.contains('*') { folder.is_dir() } else { root.join(path).is_file() };
        assert!(made || there, "{path} is not there");
    }
}

/// Needs systemd's own judge; without it there is nothing to ask.
#[test]
fn the_unit_is_tight() {
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/bustape.service");
    let mut command = Command::new("systemd-analyze");
    command.args(["security", "--offline=true", "--threshold=15"]).arg(unit);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    // Its exit status tells whether the exposure is above 1.5.
    let judged = command.status();
    assert!(judged.is_err() || judged.is_ok_and(|status| status.success()), "above 1.5");
}
