//! From an address to a socket that receives, or a sentence that says why not.

use std::io;

use super::bitrate::{self, Rate};
use super::interfaces::{self, CanInterfaceInfo};
use super::settings::CanSettings;
use super::{CanOptions, SocketCan};
use crate::capture::{CaptureError, Source};
use crate::frame::Level;
use crate::sys::CanSocket;
use crate::sys::link;

impl SocketCan {
    /// Opens the interface that `settings` name. From here on the kernel queues its frames.
    ///
    /// # Errors
    /// A sentence with the next step: no such interface, not a CAN interface, down, another bit
    /// rate, a kernel without CAN, no permission.
    pub fn open(
        settings: &CanSettings,
        options: &CanOptions,
    ) -> Result<Box<dyn Source>, CaptureError> {
        // Before the interface is looked for: a kernel without CAN has none.
        let socket = CanSocket::new().map_err(no_socket)?;
        let mut info = look_up(settings)?;
        let mut notices = Vec::new();
        match bitrate::ensure(settings, &info)? {
            Rate::AsAsked => {}
            Rate::Ignored(text) => notices.push((Level::Info, text)),
            Rate::Set(text) => {
                notices.push((Level::Info, text));
                info = look_up(settings)?;
            }
        }
        if !info.up {
            return Err(down(&info));
        }
        let granted = prepare(&socket, settings, options).and_then(|granted| {
            socket.bind(info.index)?;
            Ok(granted)
        });
        let granted = granted.map_err(|error| {
            CaptureError(format!("cannot listen to {}: {error}", settings.interface))
        })?;
        if granted < options.receive_buffer {
            notices.push((Level::Warning, small_buffer(settings, options, granted)));
        }
        let (settings, options) = (settings.clone(), options.clone());
        Ok(Box::new(Self { settings, options, socket, info, granted, notices }))
    }
}

/// A socket like the first one, for an interface that has come back under another index.
pub(super) fn again(
    settings: &CanSettings,
    options: &CanOptions,
    index: u32,
) -> io::Result<CanSocket> {
    let socket = CanSocket::new()?;
    prepare(&socket, settings, options)?;
    socket.bind(index)?;
    Ok(socket)
}

/// Sets every option, so that the first frame after the bind is treated like the others.
/// Returns the size of the receive buffer.
fn prepare(socket: &CanSocket, settings: &CanSettings, options: &CanOptions) -> io::Result<usize> {
    socket.receive_fd_frames()?;
    socket.receive_errors(options.error_mask_for(settings))?;
    if !settings.filters.is_empty() {
        let filter = |f: &super::CanFilter| libc::can_filter { can_id: f.id, can_mask: f.mask };
        let filters: Vec<_> = settings.filters.iter().map(filter).collect();
        socket.filter(&filters, settings.join)?;
    }
    socket.count_drops()?;
    socket.stamp()?;
    if options.hardware_timestamps {
        socket.stamp_by_hardware()?;
    }
    socket.set_receive_buffer(options.receive_buffer)
}

fn look_up(settings: &CanSettings) -> Result<CanInterfaceInfo, CaptureError> {
    let name = &settings.interface;
    match link::link(name) {
        Ok(Some(link)) if link.can => Ok(interfaces::describe(link)),
        Ok(Some(_)) => {
            Err(CaptureError(format!("{name} is not a CAN interface; {}", those_there_are())))
        }
        Ok(None) => Err(CaptureError(format!(
            "there is no interface {name}; {}. A virtual one is made with: \
             ip link add dev {name} type vcan && ip link set {name} up",
            those_there_are()
        ))),
        Err(error) => Err(CaptureError(format!("cannot look up interface {name}: {error}"))),
    }
}

fn those_there_are() -> String {
    let interfaces = interfaces::can_interfaces().unwrap_or_default();
    if interfaces.is_empty() {
        return "this machine has no CAN interfaces".into();
    }
    let list: Vec<_> = interfaces
        .iter()
        .map(|i| {
            let kind = i.kind.as_deref().unwrap_or("can");
            format!("{} ({kind}, {})", i.name, if i.up { "up" } else { "down" })
        })
        .collect();
    format!("CAN interfaces of this machine: {}", list.join(", "))
}

fn down(info: &CanInterfaceInfo) -> CaptureError {
    let name = &info.name;
    let controller = info.kind.as_deref() == Some("can");
    CaptureError(match info.bitrate {
        None if controller => format!(
            "{name} is down; bring it up, N being the bit rate of the bus such as 500000, with: \
             ip link set {name} up type can bitrate N"
        ),
        _ => format!("{name} is down; bring it up with: ip link set {name} up"),
    })
}

fn no_socket(error: io::Error) -> CaptureError {
    CaptureError(match error.raw_os_error() {
        Some(libc::EAFNOSUPPORT | libc::EPROTONOSUPPORT) => {
            "this kernel has no CAN sockets; load them with: modprobe can_raw (if there is no \
             such module, the kernel was built without CAN)"
                .into()
        }
        Some(libc::EPERM | libc::EACCES) => {
            "opening a CAN socket is not permitted here: a sandbox or container forbids the \
             address family AF_CAN (CAN itself needs no privilege)"
                .into()
        }
        _ => format!("cannot open a CAN socket: {error}"),
    })
}

fn small_buffer(settings: &CanSettings, options: &CanOptions, granted: usize) -> String {
    let (name, wanted) = (&settings.interface, options.receive_buffer);
    format!(
        "{name}: the kernel gave a receive buffer of {granted} bytes instead of {wanted}; for all \
         of it: sysctl net.core.rmem_max={wanted}"
    )
}
