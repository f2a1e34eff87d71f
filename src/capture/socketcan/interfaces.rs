//! The CAN interfaces of this machine.

use std::io;

use socketcan::{CanCtrlMode, CanInterface};

use crate::sys::link::{self, Link};

/// What the kernel says about a CAN interface. Anybody may read it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CanInterfaceInfo {
    /// Its name.
    pub name: String,
    /// Its number, unique until the machine restarts.
    pub index: u32,
    /// What made it, as the kernel calls it: `can` for a controller, `vcan`, `vxcan`, ...
    /// `None` where the kernel does not say (some out-of-tree drivers).
    pub kind: Option<String>,
    /// True when it is up.
    pub up: bool,
    /// State of the controller as ip(8) calls it, such as `ERROR-ACTIVE` or `BUS-OFF`; `None` for
    /// virtual interfaces.
    pub state: Option<&'static str>,
    /// Nominal bit rate, bit/s, where one is set.
    pub bitrate: Option<u32>,
    /// Bit rate of the CAN FD data phase, bit/s, where one is set.
    pub data_bitrate: Option<u32>,
    /// Largest frame, bytes: 16 without CAN FD, 72 with it.
    pub mtu: u32,
    /// The driver, such as `gs_usb`; `None` for virtual interfaces.
    pub driver: Option<String>,
    /// After how many milliseconds the controller restarts from bus-off; 0 for never.
    pub restart_ms: Option<u32>,
    /// Modes that are on, as ip(8) calls them, such as `FD` or `LISTEN-ONLY`.
    pub modes: Vec<&'static str>,
}

/// All CAN interfaces; none where the kernel has none.
///
/// # Errors
/// Where netlink is not permitted (a sandbox).
pub fn can_interfaces() -> io::Result<Vec<CanInterfaceInfo>> {
    let links = link::links()?.into_iter().filter(|link| link.can);
    Ok(links.map(describe).collect())
}

/// What the kernel says about `link`. Facts it does not give are left out.
pub(super) fn describe(link: Link) -> CanInterfaceInfo {
    let mut info = CanInterfaceInfo {
        driver: driver(&link.name),
        name: link.name,
        index: link.index,
        kind: link.kind,
        up: link.up,
        mtu: link.mtu,
        ..CanInterfaceInfo::default()
    };
    if info.kind.as_deref() == Some("can") {
        add_controller(&mut info);
    }
    info
}

fn add_controller(info: &mut CanInterfaceInfo) {
    // Gone since it was listed, or a kernel that tells less: then these facts stay unknown.
    let Ok(can) = CanInterface::open_iface(info.index).can_params() else { return };
    let set = |rate: u32| (rate > 0).then_some(rate);
    info.state = can.state.map(state_name);
    info.bitrate = can.bit_timing.and_then(|timing| set(timing.bitrate));
    info.data_bitrate = can.data_bit_timing.and_then(|timing| set(timing.bitrate));
    info.restart_ms = can.restart_ms;
    if let Some(modes) = can.ctrl_mode {
        info.modes = MODES.iter().filter(|(m, _)| modes.has_mode(*m)).map(|(_, n)| *n).collect();
    }
}

/// Names of `ip/iplink_can.c` of iproute2.
const MODES: [(CanCtrlMode, &str); 9] = [
    (CanCtrlMode::Loopback, "LOOPBACK"),
    (CanCtrlMode::ListenOnly, "LISTEN-ONLY"),
    (CanCtrlMode::TripleSampling, "TRIPLE-SAMPLING"),
    (CanCtrlMode::OneShot, "ONE-SHOT"),
    (CanCtrlMode::BerrReporting, "BERR-REPORTING"),
    (CanCtrlMode::Fd, "FD"),
    (CanCtrlMode::PresumeAck, "PRESUME-ACK"),
    (CanCtrlMode::NonIso, "FD-NON-ISO"),
    (CanCtrlMode::CcLen8Dlc, "CC-LEN8-DLC"),
];

fn state_name(state: socketcan::nl::CanState) -> &'static str {
    use socketcan::nl::CanState;
    match state {
        CanState::ErrorActive => "ERROR-ACTIVE",
        CanState::ErrorWarning => "ERROR-WARNING",
        CanState::ErrorPassive => "ERROR-PASSIVE",
        CanState::BusOff => "BUS-OFF",
        CanState::Stopped => "STOPPED",
        CanState::Sleeping => "SLEEPING",
    }
}

fn driver(name: &str) -> Option<String> {
    let target = std::fs::read_link(format!("/sys/class/net/{name}/device/driver")).ok()?;
    Some(target.file_name()?.to_string_lossy().into_owned())
}
