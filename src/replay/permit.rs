//! The right to transmit: by default only where no real device can hear it.

use super::ReplayError;
use super::target::TargetAddress;
use crate::sys::link::{self, Link};

/// A target, and whether anything real can hear what is sent there.
#[derive(Clone, Debug)]
pub struct Reach {
    /// The name that `--transmit-on` has to repeat.
    pub name: String,
    /// What stands there, for a person: `vcan`, `can controller`, `serial port`, ...
    pub kind: String,
    /// True if nothing outside of this host can hear it.
    pub is_virtual: bool,
    /// The CAN interface, as it was when it was judged.
    pub link: Option<Link>,
}

impl Reach {
    /// Looks what stands at `address`. An interface is judged by the kernel's kind of it, never by
    /// its name; only `vcan` is virtual.
    ///
    /// # Errors
    /// There is no such interface, it is not CAN, or it is down.
    pub fn of(address: &TargetAddress) -> Result<Self, ReplayError> {
        let name = address.name();
        let (kind, is_virtual, link) = match address {
            TargetAddress::Can(interface) => {
                let link = can_interface(interface)?;
                let kind = match link.kind.as_deref() {
                    None | Some("can") => "CAN controller".to_owned(),
                    Some(kind) => format!("{kind} interface"),
                };
                (kind, link.is_virtual_can(), Some(link))
            }
            TargetAddress::Slcan(_) => ("slcan adapter".to_owned(), false, None),
            TargetAddress::Port { .. } => ("serial port".to_owned(), false, None),
            TargetAddress::Pty(_) => ("pseudo-terminal".to_owned(), true, None),
            TargetAddress::Trace => ("text".to_owned(), true, None),
        };
        Ok(Self { name, kind, is_virtual, link })
    }
}

/// The interface with this name, if it is a CAN interface that is up.
pub fn can_interface(name: &str) -> Result<Link, ReplayError> {
    let refuse = |why: String| Err(ReplayError(why));
    match link::link(name) {
        Ok(Some(link)) if !link.can => refuse(format!("{name} is not a CAN interface")),
        Ok(Some(link)) if !link.up => {
            refuse(format!("{name} is down; bring it up with: ip link set {name} up"))
        }
        Ok(Some(link)) => Ok(link),
        Ok(None) => refuse(format!(
            "there is no interface {name}. A virtual one is made with: ip link add dev {name} type \
             vcan && ip link set {name} up"
        )),
        Err(error) => refuse(format!("cannot look up interface {name}: {error}")),
    }
}

/// Proof that every target may be sent to. Only [`grant`] makes one.
#[derive(Debug)]
pub struct Permit(());

/// Gives the permit if every target that is not virtual is named in `allowed`.
///
/// # Errors
/// The targets that are not, in one sentence.
pub fn grant(targets: &[Reach], allowed: &[String]) -> Result<Permit, ReplayError> {
    let refused: Vec<&Reach> =
        targets.iter().filter(|t| !t.is_virtual && !allowed.contains(&t.name)).collect();
    if refused.is_empty() {
        return Ok(Permit(()));
    }
    let list: Vec<String> = refused.iter().map(|t| format!("{} ({})", t.name, t.kind)).collect();
    let options: Vec<String> =
        refused.iter().map(|t| format!("--transmit-on {}", t.name)).collect();
    Err(ReplayError(format!(
        "not sent: {} may reach real devices; if they shall hear this replay, say so with {}",
        list.join(", "),
        options.join(" ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reach(name: &str, is_virtual: bool) -> Reach {
        Reach { name: name.to_owned(), kind: "kind".to_owned(), is_virtual, link: None }
    }

    #[test]
    fn every_target_that_is_not_virtual_must_be_named() {
        let targets = [reach("vcan0", true), reach("can0", false), reach("/dev/ttyUSB0", false)];
        let allow = |names: &[&str]| {
            grant(&targets, &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>())
        };
        let refusal = allow(&["can0"]).unwrap_err().0;
        assert!(refusal.contains("--transmit-on /dev/ttyUSB0") && !refusal.contains("can0"));
        assert!(allow(&["can0", "/dev/ttyUSB0"]).is_ok());
        assert!(grant(&targets[..1], &[]).is_ok());
    }

    #[test]
    fn only_the_kernels_word_makes_an_interface_virtual() {
        let link = |kind: &str| Link { can: true, kind: Some(kind.to_owned()), ..Link::default() };
        let named = |kind: &str| Link { name: "vcan0".to_owned(), ..link(kind) };
        assert!(Link { name: "can9".to_owned(), ..link("vcan") }.is_virtual_can());
        for kind in ["can", "vxcan", "slcan", "dummy"] {
            assert!(!named(kind).is_virtual_can(), "{kind}");
        }
        assert!(!Link { kind: None, ..named("") }.is_virtual_can());
    }
}
