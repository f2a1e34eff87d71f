//! Where something may be sent without being asked twice.
//!
//! A frame on a real bus moves real machines. So whatever transmits sends to things that exist in
//! the kernel only, and to anything else when a person has named it with `--transmit-on`.
//! What an interface is, the kernel says (`IFLA_INFO_KIND` of rtnetlink(7)), not its name. Of
//! terminals only one that we have made ourselves is virtual.

use std::path::Path;

use crate::sys::link::Link;

/// A target, and whether anything real can hear what is sent there.
#[derive(Clone, Debug)]
pub struct Reach {
    /// The name that `--transmit-on` has to repeat.
    pub name: String,
    /// What stands there, for a person: `vcan interface`, `CAN controller`, `serial port`, ...
    pub kind: String,
    /// True if nothing outside of this host can hear it.
    pub is_virtual: bool,
    /// The CAN interface, as it was when it was judged.
    pub link: Option<Link>,
}

impl Reach {
    /// An interface is judged by the kernel's kind of it; only `vcan` is virtual. The other end of a
    /// `vxcan` may stand in a container that forwards to a wire.
    pub fn of_interface(link: Link) -> Self {
        let kind = match link.kind.as_deref() {
            None | Some("can") => "CAN controller".to_owned(),
            Some(kind) => format!("{kind} interface"),
        };
        let (name, is_virtual) = (link.name.clone(), link.is_virtual_can());
        Self { name, kind, is_virtual, link: Some(link) }
    }

    /// A port is real even if it is a pseudo-terminal: behind one that somebody else has made there
    /// may be a bridge to a line.
    pub fn of_port(path: &Path) -> Self {
        Self::known(path, "serial port", false)
    }

    /// A CAN adapter at a port.
    pub fn of_adapter(path: &Path) -> Self {
        Self::known(path, "slcan adapter", false)
    }

    /// A pseudo-terminal that we make and link at `path`.
    pub fn of_own_terminal(path: &Path) -> Self {
        Self::known(path, "pseudo-terminal", true)
    }

    /// Text on stdout, under the name by which it is asked for.
    pub fn of_text(name: &str) -> Self {
        Self::known(Path::new(name), "text", true)
    }

    fn known(name: &Path, kind: &str, is_virtual: bool) -> Self {
        Self { name: name.display().to_string(), kind: kind.to_owned(), is_virtual, link: None }
    }
}

/// Nothing was sent, because nobody permitted it: exit status 4. The text is the whole sentence.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub String);

/// Proof that every target may be sent to. Only [`grant`] makes one.
#[derive(Debug)]
pub struct Permit(());

/// Gives the permit if every target that is not virtual is named in `allowed`, which is what
/// `--transmit-on` lists.
///
/// # Errors
/// The targets that are not, in one sentence.
pub fn grant(targets: &[Reach], allowed: &[String]) -> Result<Permit, Refused> {
    let refused: Vec<&Reach> =
        targets.iter().filter(|t| !t.is_virtual && !allowed.contains(&t.name)).collect();
    if refused.is_empty() {
        return Ok(Permit(()));
    }
    let list: Vec<String> = refused.iter().map(|t| format!("{} ({})", t.name, t.kind)).collect();
    let options: Vec<String> =
        refused.iter().map(|t| format!("--transmit-on {}", t.name)).collect();
    Err(Refused(format!(
        "nothing was sent: {} may reach real devices, which might obey; if they shall, add {}",
        list.join(", "),
        options.join(" ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interface(name: &str, kind: Option<&str>) -> Reach {
        let kind = kind.map(str::to_owned);
        Reach::of_interface(Link { name: name.to_owned(), kind, can: true, ..Link::default() })
    }

    #[test]
    fn the_kernels_kind_counts_and_not_the_name() {
        assert!(grant(&[interface("can0", Some("vcan"))], &[]).is_ok());
        for kind in [Some("can"), Some("slcan"), Some("vxcan"), Some("dummy"), None] {
            let target = [interface("vcan0", kind)];
            let refused = grant(&target, &["can0".to_owned()]).unwrap_err().to_string();
            assert!(refused.starts_with("nothing was sent: vcan0 ("), "{refused}");
            assert!(refused.ends_with("add --transmit-on vcan0"), "{refused}");
            assert!(grant(&target, &["vcan0".to_owned()]).is_ok());
        }
    }

    #[test]
    fn every_target_that_is_not_virtual_must_be_named() {
        let port = Reach::of_port(Path::new("/dev/ttyUSB0"));
        let targets = [interface("vcan0", Some("vcan")), interface("can0", None), port];
        let allow = |names: &[&str]| {
            grant(&targets, &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>())
        };
        let refusal = allow(&["can0"]).unwrap_err().0;
        assert!(refusal.contains("--transmit-on /dev/ttyUSB0") && !refusal.contains("can0"));
        assert!(allow(&["can0", "/dev/ttyUSB0"]).is_ok());
        assert!(grant(&targets[..1], &[]).is_ok());
    }

    #[test]
    fn a_terminal_of_somebody_else_is_real_and_our_own_is_not() {
        let pty = crate::sys::pty::Pty::new().unwrap();
        assert!(!Reach::of_port(pty.path()).is_virtual);
        assert!(!Reach::of_adapter(pty.path()).is_virtual);
        assert!(Reach::of_own_terminal(pty.path()).is_virtual);
    }
}
