//! What stands at a target.

use super::ReplayError;
use super::target::TargetAddress;
use crate::permit::Reach;
use crate::sys::link::{self, Link};

/// Looks what stands at `address`. A serial port is real even if it is somebody's
/// pseudo-terminal: a bridge to a line may be behind it.
///
/// # Errors
/// There is no such interface, it is not CAN, or it is down.
pub fn reach_of(address: &TargetAddress) -> Result<Reach, ReplayError> {
    let (kind, is_virtual) = match address {
        TargetAddress::Can(name) => return Ok(Reach::of_interface(can_interface(name)?)),
        TargetAddress::Slcan(_) => ("slcan adapter", false),
        TargetAddress::Port { .. } => ("serial port", false),
        TargetAddress::Pty(_) => ("pseudo-terminal", true),
        TargetAddress::Trace => ("text", true),
    };
    Ok(Reach::known(address.name(), kind, is_virtual))
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
