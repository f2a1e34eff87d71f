//! What stands at a target.

use super::ReplayError;
use super::target::TargetAddress;
use crate::permit::Reach;
use crate::sys::link::{self, Link};

/// Looks what stands at `address`, and has it judged.
///
/// # Errors
/// There is no such interface, it is not CAN, or it is down.
pub fn reach_of(address: &TargetAddress) -> Result<Reach, ReplayError> {
    Ok(match address {
        TargetAddress::Can(name) => Reach::of_interface(can_interface(name)?),
        TargetAddress::Slcan(adapter) => Reach::of_adapter(&adapter.path),
        TargetAddress::Port { path, .. } => Reach::of_port(path),
        TargetAddress::Pty(path) => Reach::of_own_terminal(path),
        TargetAddress::Trace => Reach::of_text(&address.name()),
    })
}

/// The interface with this name, if it is a CAN interface that is up.
fn can_interface(name: &str) -> Result<Link, ReplayError> {
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
