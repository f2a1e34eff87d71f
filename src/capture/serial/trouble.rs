//! Sentences for a serial port that cannot be opened: what, why, and what to do.

use std::fs;
use std::io::ErrorKind::{NotFound, PermissionDenied};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::Path;

use nix::errno::Errno;
use nix::unistd::{Gid, Group};
use serialport::ErrorKind;

use super::identity::holders;
use super::ports::serial_ports;

/// Why `path` could not be opened, as a sentence.
pub(crate) fn cannot_open(path: &Path, error: &serialport::Error) -> String {
    let what = format!("cannot open serial port {}", path.display());
    let why = match error.kind {
        ErrorKind::Io(NotFound) => missing(),
        ErrorKind::Io(PermissionDenied) => not_permitted(path),
        // EBUSY, and a lock that another program holds.
        ErrorKind::NoDevice => busy(path),
        _ if not_a_tty(path, error) => "it is not a serial port".to_owned(),
        // TTYPort compares what it asked for with what it got, and has only this text for it.
        _ if error.description.contains("did not apply") => {
            "the driver refused its settings; try another format or baud rate".to_owned()
        }
        _ if error.description == Errno::EIO.desc() => {
            "no hardware answers behind it; choose one that `bustape ports` lists".to_owned()
        }
        _ => error.description.clone(),
    };
    format!("{what}: {why}")
}

fn missing() -> String {
    let ports: Vec<_> = serial_ports().iter().map(|p| p.path.display().to_string()).collect();
    if ports.is_empty() {
        "there is no such device, and no other serial port either; is it plugged in?".to_owned()
    } else {
        format!("there is no such device; serial ports now: {}", ports.join(", "))
    }
}

fn not_permitted(path: &Path) -> String {
    let group = fs::metadata(path).ok().map(|m| (m.gid(), m.mode()));
    let group = match group {
        // Group root, or a group that may not read and write either, would not help.
        Some((gid, mode)) if gid != 0 && mode & 0o060 == 0o060 => {
            Group::from_gid(Gid::from_raw(gid)).ok().flatten()
        }
        _ => None,
    };
    match group {
        Some(Group { name, .. }) => format!(
            "permission denied; it belongs to the group {name}: run `sudo usermod -aG {name} $USER` \
             and log in again"
        ),
        None => "permission denied; ask whoever looks after this computer for access".to_owned(),
    }
}

fn busy(path: &Path) -> String {
    match holders(path).first() {
        Some(holder) => format!(
            "it is in use by process {} ({}); close that program first",
            holder.pid, holder.name
        ),
        None => "it is in use by another program; close that one first".to_owned(),
    }
}

fn not_a_tty(path: &Path, error: &serialport::Error) -> bool {
    error.description == Errno::ENOTTY.desc()
        || fs::metadata(path).is_ok_and(|m| !m.file_type().is_char_device())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentence(path: &str) -> String {
        let error = crate::sys::tty::Tty::open(&serialport::new(path, 9600)).unwrap_err();
        cannot_open(Path::new(path), &error)
    }

    #[test]
    fn each_failure_says_what_to_do() {
        let missing = sentence("/dev/ttyNONE7");
        assert!(missing.starts_with("cannot open serial port /dev/ttyNONE7: there is no such"));
        for path in ["/dev/null", "/etc/passwd", "/tmp"] {
            assert!(sentence(path).ends_with("it is not a serial port"), "{}", sentence(path));
        }
    }

    #[test]
    fn a_port_that_another_program_holds_names_that_program() {
        let pty = crate::sys::pty::Pty::new().unwrap();
        let path = pty.path().to_str().unwrap().to_owned();
        let lock = "import fcntl,os,sys,time\n\
                    f=os.open(sys.argv[1],os.O_RDWR|os.O_NOCTTY)\n\
                    fcntl.flock(f,fcntl.LOCK_EX); print('locked',flush=True); time.sleep(20)";
        let mut child = std::process::Command::new("python3")
            .args(["-c", lock, &path])
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = [0; 7];
        std::io::Read::read_exact(child.stdout.as_mut().unwrap(), &mut line).unwrap();
        let text = sentence(&path);
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(text.contains(&format!("in use by process {} (python3", child.id())), "{text}");
    }

    #[test]
    fn no_permission_names_the_group_to_join() {
        // Any file with a group of its own serves; what matters is who may open it.
        let file = tempfile::NamedTempFile::new().unwrap();
        let daemon = Group::from_name("daemon").unwrap().unwrap();
        std::os::unix::fs::chown(file.path(), None, Some(daemon.gid.as_raw())).ok();
        fs::set_permissions(file.path(), std::os::unix::fs::PermissionsExt::from_mode(0o660))
            .unwrap();
        if fs::metadata(file.path()).unwrap().gid() == daemon.gid.as_raw() {
            assert!(not_permitted(file.path()).contains("sudo usermod -aG daemon $USER"));
        }
    }
}
