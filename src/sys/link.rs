//! Network interfaces as the kernel's rtnetlink shows them, to anybody.
//!
//! Sources: rtnetlink(7), `linux/if_link.h`, `linux/can/netlink.h`.

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};

use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, bind, recv, send,
    socket,
};

use super::netlink::{self, LinkMessage};

/// A dump comes in pieces of at most 32 KiB.
const BUFFER: usize = 64 << 10;

/// A network interface.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Link {
    /// Its number, unique until the machine restarts.
    pub index: u32,
    /// Its name.
    pub name: String,
    /// True for a CAN interface (`ARPHRD_CAN`), real or virtual.
    pub can: bool,
    /// True when it is administratively up (`IFF_UP`).
    pub up: bool,
    /// Largest frame, bytes: 16 classic CAN, 72 CAN FD.
    pub mtu: u32,
    /// What made it (`IFLA_INFO_KIND`): `can` for a controller, `vcan`, `vxcan`, ...
    pub kind: Option<String>,
    /// What a CAN controller may do: `enum can_state` of `linux/can/netlink.h`.
    pub state: Option<u32>,
    /// A CAN controller's counters of errors in transmitting and receiving.
    pub errors: Option<(u16, u16)>,
}

impl Link {
    /// True for a CAN interface whose frames never leave this host (`vcan`), whatever its name.
    /// A `vxcan` does not count: its other end may be in another namespace, on another's desk.
    pub fn is_virtual_can(&self) -> bool {
        self.can && self.kind.as_deref() == Some("vcan")
    }
}

/// All network interfaces.
///
/// # Errors
/// Where netlink is not permitted (a sandbox).
pub fn links() -> io::Result<Vec<Link>> {
    let request = netlink::request(None);
    let mut links = Vec::new();
    ask(&request, |message| match message {
        LinkMessage::Link(link) => links.push(link),
        LinkMessage::Error(_) | LinkMessage::Done => {}
    })?;
    Ok(links)
}

/// The interface with this name, if there is one.
///
/// # Errors
/// Where netlink is not permitted (a sandbox).
pub fn link(name: &str) -> io::Result<Option<Link>> {
    let request = netlink::request(Some(name));
    let mut found = None;
    let asked = ask(&request, |message| {
        if let LinkMessage::Link(link) = message {
            found = Some(link);
        }
    });
    match asked {
        // ERANGE: a name longer than any interface's.
        Err(error) if matches!(error.raw_os_error(), Some(libc::ENODEV | libc::ERANGE)) => Ok(None),
        Err(error) => Err(error),
        Ok(()) => Ok(found),
    }
}

/// Takes an interface up or down.
///
/// # Errors
/// `EPERM` without `CAP_NET_ADMIN`, `ENODEV` where it is gone, those of its driver.
pub fn set_up(index: u32, up: bool) -> io::Result<()> {
    ask(&netlink::request_up(index, up), |_| {})
}

/// Sets the bit rate of a CAN controller that is down, bit/s; with a data bit rate also CAN FD.
///
/// # Errors
/// `EPERM` without `CAP_NET_ADMIN`, `EBUSY` while it is up, `EINVAL`, `ERANGE` or `EDOM` for a
/// rate it cannot make, `EOPNOTSUPP` where it has no CAN FD or no bit rate.
pub fn set_bitrate(index: u32, bitrate: u32, data: Option<u32>) -> io::Result<()> {
    ask(&netlink::request_bitrate(index, bitrate, data), |_| {})
}

/// Sends a request and hands every message of the answer to `each`, up to its end.
fn ask(request: &[u8], mut each: impl FnMut(LinkMessage)) -> io::Result<()> {
    let socket = route_socket(SockFlag::empty())?;
    send(socket.as_raw_fd(), request, MsgFlags::empty())?;
    let mut buffer = vec![0; BUFFER];
    loop {
        let length = recv(socket.as_raw_fd(), &mut buffer, MsgFlags::empty())?;
        for message in netlink::messages(buffer.get(..length).unwrap_or_default()) {
            match message {
                // The answer to a request that asked to be acknowledged ends with error 0.
                LinkMessage::Error(0) | LinkMessage::Done => return Ok(()),
                LinkMessage::Error(errno) => return Err(io::Error::from_raw_os_error(errno)),
                link @ LinkMessage::Link(_) => each(link),
            }
        }
    }
}

fn route_socket(flags: SockFlag) -> io::Result<OwnedFd> {
    let flags = flags | SockFlag::SOCK_CLOEXEC;
    Ok(socket(AddressFamily::Netlink, SockType::Raw, flags, SockProtocol::NetlinkRoute)?)
}

/// Becomes readable whenever the kernel changes a network interface.
#[derive(Debug)]
pub struct LinkWatch(OwnedFd);

impl LinkWatch {
    /// Starts to watch.
    ///
    /// # Errors
    /// Where netlink is not permitted (a sandbox).
    pub fn new() -> io::Result<Self> {
        let socket = route_socket(SockFlag::SOCK_NONBLOCK)?;
        bind(socket.as_raw_fd(), &NetlinkAddr::new(0, libc::RTMGRP_LINK.cast_unsigned()))?;
        Ok(Self(socket))
    }

    /// Forgets the changes announced so far. What they were does not matter to whoever looks at
    /// the interface after this call.
    ///
    /// # Errors
    /// `EAGAIN`, always, when there are no more.
    pub fn clear(&self) -> io::Result<()> {
        let mut byte = [0];
        loop {
            // A longer message is cut; ENOBUFS says that the kernel had too many.
            match recv(self.0.as_raw_fd(), &mut byte, MsgFlags::MSG_DONTWAIT) {
                Ok(_) | Err(nix::errno::Errno::ENOBUFS | nix::errno::Errno::EINTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
}

impl AsRawFd for LinkWatch {
    fn as_raw_fd(&self) -> RawFd {
        self.0.as_raw_fd()
    }
}

impl AsFd for LinkWatch {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_has_a_loopback_interface_which_is_not_can() {
        let links = links().unwrap();
        let loopback = links.iter().find(|link| link.name == "lo").unwrap();
        assert!(!loopback.can && loopback.kind.is_none() && loopback.mtu > 0);
        assert_eq!(link("lo").unwrap().as_ref(), Some(loopback));
    }

    #[test]
    fn names_that_no_interface_has_are_not_found() {
        assert_eq!(link("nosuchbus7").unwrap(), None);
        assert_eq!(link(&"x".repeat(300)).unwrap(), None);
    }
}
