//! Where something may be sent without being asked twice.
//!
//! A frame on a real bus moves real machines. So whatever transmits sends to things that exist in
//! the kernel only, and to anything else when a person has named it with `--transmit-on`.
//! What an interface is, the kernel says (`IFLA_INFO_KIND` of rtnetlink(7), device numbers), not
//! its name.

use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;

use crate::sys::link::Link;

/// Nothing was sent, because nobody permitted it: exit status 4. The text is the whole sentence.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub String);

/// Whether frames may be sent on the interface `link`; `named` is what `--transmit-on` lists.
///
/// # Errors
/// [`Refused`] where it is not virtual and not named.
pub fn can(link: &Link, named: &[String]) -> Result<(), Refused> {
    if link.is_virtual_can() || named.contains(&link.name) {
        return Ok(());
    }
    let kind = link.kind.as_deref().unwrap_or("unknown");
    Err(Refused(format!(
        "nothing was sent: {name} is not a virtual interface (its kind is {kind}), and what is on \
         it might obey; use a vcan interface, or add --transmit-on {name}",
        name = link.name
    )))
}

/// Whether bytes may be written to the serial port at `path`; `named` is what `--transmit-on`
/// lists. An application's side of a pseudo-terminal has no line behind it.
///
/// # Errors
/// [`Refused`] where it is not a pseudo-terminal and not named.
pub fn serial(path: &Path, named: &[String]) -> Result<(), Refused> {
    if is_pseudo_terminal(path).unwrap_or(false) || named.iter().any(|name| Path::new(name) == path)
    {
        return Ok(());
    }
    let path = path.display();
    Err(Refused(format!(
        "nothing was sent: {path} is not a pseudo-terminal, and what is behind it might obey; use \
         pty:PATH, or add --transmit-on {path}"
    )))
}

/// Unix98 pseudo-terminals have the majors 136 to 143 (devices.txt of the kernel).
fn is_pseudo_terminal(path: &Path) -> io::Result<bool> {
    let device = std::fs::metadata(path)?.rdev();
    Ok((136..=143).contains(&nix::sys::stat::major(device)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link(name: &str, kind: Option<&str>) -> Link {
        Link { name: name.to_owned(), kind: kind.map(str::to_owned), can: true, ..Link::default() }
    }

    #[test]
    fn the_kernels_kind_counts_and_not_the_name() {
        assert_eq!(can(&link("can0", Some("vcan")), &[]), Ok(()));
        // The other end of a vxcan may stand in a container that forwards to a wire.
        for kind in [Some("can"), Some("slcan"), Some("vxcan"), None] {
            let refused = can(&link("vcan0", kind), &["can0".to_owned()]).unwrap_err().to_string();
            assert!(refused.starts_with("nothing was sent: vcan0 is not a virtual"), "{refused}");
            assert!(refused.ends_with("add --transmit-on vcan0"), "{refused}");
            assert_eq!(can(&link("vcan0", kind), &["vcan0".to_owned()]), Ok(()));
        }
    }

    #[test]
    fn a_pseudo_terminal_is_known_by_its_device_number() {
        let pty = crate::sys::pty::Pty::new().unwrap();
        assert_eq!(serial(pty.path(), &[]), Ok(()));
        for other in ["/dev/null", "/dev/no-such-port"] {
            let refused = serial(Path::new(other), &[]).unwrap_err().to_string();
            assert!(refused.contains(&format!("--transmit-on {other}")), "{refused}");
            assert_eq!(serial(Path::new(other), &[other.to_owned()]), Ok(()));
        }
    }
}
