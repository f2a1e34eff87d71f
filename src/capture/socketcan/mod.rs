//! SocketCAN: frames of a CAN interface of this machine. Listens, never sends.

mod bitrate;
mod encode;
mod hardware;
mod interfaces;
mod message;
mod open;
mod pace;
mod passes;
mod port;
mod reader;
mod run;
mod settings;

use std::collections::BTreeMap;

pub use encode::encode;
pub use interfaces::{CanInterfaceInfo, can_interfaces};
pub use message::{decode_frame, decode_stamped};
pub use settings::{CanFilter, CanSettings};

use super::{BusFacts, Running, Source, Stop};
use crate::frame::{Level, Unit};
use crate::queue::Inlet;
use crate::sys::CanSocket;

/// Every class of error frames: `CAN_ERR_MASK` of `linux/can.h`.
const ALL_ERRORS: u32 = libc::CAN_ERR_MASK;

/// How to listen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanOptions {
    /// Receive buffer in the kernel, bytes, as `net.core.rmem_max` counts them. The kernel sets
    /// aside twice as much; a classic frame takes about 770 bytes of that.
    pub receive_buffer: usize,
    /// Take the time of reception from the controller where its driver supplies it. Its clock has
    /// an epoch of its own, so its times are placed on the recording's timeline by the smallest
    /// difference to the kernel's stamps seen in the last second or two. Otherwise, and for
    /// frames without a hardware time, the kernel's stamp counts.
    pub hardware_timestamps: bool,
    /// Which classes of error frames to record (`linux/can/error.h`), 0 for none. An address may
    /// say otherwise.
    pub error_mask: u32,
}

impl Default for CanOptions {
    /// 4 MiB, which hold about 10,000 frames or a second of a full 1 Mbit/s bus; the kernel's
    /// time stamps; all error frames.
    fn default() -> Self {
        Self { receive_buffer: 4 << 20, hardware_timestamps: false, error_mask: ALL_ERRORS }
    }
}

impl CanOptions {
    fn error_mask_for(&self, settings: &CanSettings) -> u32 {
        settings.error_mask.unwrap_or(self.error_mask) & ALL_ERRORS
    }
}

/// A CAN interface, opened: the kernel already queues its frames.
#[derive(Debug)]
pub struct SocketCan {
    settings: CanSettings,
    options: CanOptions,
    socket: CanSocket,
    info: CanInterfaceInfo,
    /// Size of the receive buffer, bytes.
    granted: usize,
    /// What a person should know about the opening.
    notices: Vec<(Level, String)>,
}

impl Source for SocketCan {
    fn facts(&self) -> BusFacts {
        let (settings, info) = (&self.settings, &self.info);
        let mut more = BTreeMap::new();
        let mut tell = |name: &str, value: Option<String>| {
            value.map(|value| more.insert(name.to_owned(), value));
        };
        tell("interface", Some(info.name.clone()));
        tell("kind", info.kind.clone());
        tell("driver", info.driver.clone());
        tell("mtu", Some(info.mtu.to_string()));
        tell("state", Some(info.state.unwrap_or(if info.up { "UP" } else { "DOWN" }).into()));
        tell("restart_ms", info.restart_ms.map(|ms| ms.to_string()));
        tell("modes", (!info.modes.is_empty()).then(|| info.modes.join(" ")));
        tell("receive_buffer", Some(self.granted.to_string()));
        let hardware = self.options.hardware_timestamps;
        tell("timestamps", Some(if hardware { "hardware, else kernel" } else { "kernel" }.into()));
        tell("filters", (!settings.filters.is_empty()).then(|| settings.filter_text.clone()));
        let errors = self.options.error_mask_for(settings);
        tell("error_mask", Some(format!("{errors:08X}")));
        BusFacts {
            unit: Some(Unit::Frames),
            bitrate: info.bitrate,
            data_bitrate: info.data_bitrate,
            more,
        }
    }

    fn run<'a>(self: Box<Self>, inlet: Inlet, stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(run::run(*self, inlet, stop))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_the_last_word_on_error_frames() {
        let all = CanOptions::default();
        assert_eq!(all.error_mask_for(&"can0".parse().unwrap()), 0x1FFF_FFFF);
        assert_eq!(all.error_mask_for(&"can0,#C".parse().unwrap()), 0xC);
        assert_eq!(all.error_mask_for(&"can0,#FFFFFFFF".parse().unwrap()), 0x1FFF_FFFF);
    }

    #[test]
    fn an_interface_that_does_not_exist_is_refused_with_the_next_step() {
        let settings = "nosuchcan7".parse().unwrap();
        let Err(error) = SocketCan::open(&settings, &CanOptions::default()) else { panic!() };
        let (vcan, no_can) = ("type vcan && ip link set nosuchcan7 up", "modprobe can_raw");
        let text = error.to_string();
        assert!(text.contains(vcan) || text.contains(no_can), "{text}");
    }
}
