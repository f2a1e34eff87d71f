//! The bit rate an address asks for: checked, and set where it differs and we may.

use std::io;

use super::interfaces::CanInterfaceInfo;
use super::settings::CanSettings;
use crate::capture::CaptureError;
use crate::sys::link;

/// What came of it.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Rate {
    /// The interface runs at the rate asked for, or none was asked for.
    AsAsked,
    /// It does now; the sentence says what was changed.
    Set(String),
    /// The interface has no bit rate; the sentence says so.
    Ignored(String),
}

/// Sees to it that `info` is up and runs at the bit rate of `settings`, if they have one.
///
/// # Errors
/// A sentence with the command that a privileged user would give.
pub(super) fn ensure(
    settings: &CanSettings,
    info: &CanInterfaceInfo,
) -> Result<Rate, CaptureError> {
    let Some(bitrate) = settings.bitrate else { return Ok(Rate::AsAsked) };
    let name = &info.name;
    if info.kind.as_deref().is_some_and(|kind| kind != "can") {
        let kind = info.kind.as_deref().unwrap_or_default();
        return Ok(Rate::Ignored(format!(
            "{name} is virtual ({kind}) and has no bit rate: {bitrate} bit/s is ignored"
        )));
    }
    let data = settings.data_bitrate;
    if info.up && info.bitrate == Some(bitrate) && (data.is_none() || info.data_bitrate == data) {
        return Ok(Rate::AsAsked);
    }
    let before = describe(info);
    let asked = text(bitrate, data);
    match set(info, bitrate, data) {
        Ok(()) => Ok(Rate::Set(format!("set {name} to {asked}; before, it was {before}"))),
        Err(error) => Err(CaptureError(format!(
            "{name} is {before}, not at {asked}, and cannot be changed: {}",
            match error.raw_os_error() {
                Some(libc::EPERM) => format!(
                    "that needs CAP_NET_ADMIN; as a user who has it: {}",
                    command(name, bitrate, data)
                ),
                Some(libc::EINVAL | libc::ERANGE | libc::EDOM) => {
                    "its controller cannot run at this rate".into()
                }
                Some(libc::EOPNOTSUPP) => "its driver does not support that".into(),
                _ => error.to_string(),
            }
        ))),
    }
}

fn describe(info: &CanInterfaceInfo) -> String {
    match (info.up, info.bitrate) {
        (true, Some(rate)) => format!("at {}", text(rate, info.data_bitrate)),
        (true, None) => "up without a known bit rate".into(),
        (false, _) => "down".into(),
    }
}

fn text(bitrate: u32, data: Option<u32>) -> String {
    let data = data.map(|data| format!(" with a data phase at {data} bit/s")).unwrap_or_default();
    format!("{bitrate} bit/s{data}")
}

/// The commands that set the bit rate of an interface and bring it up.
pub(super) fn command(name: &str, bitrate: u32, data: Option<u32>) -> String {
    let data = data.map(|data| format!(" dbitrate {data} fd on")).unwrap_or_default();
    format!("ip link set {name} down && ip link set {name} up type can bitrate {bitrate}{data}")
}

/// The kernel takes a new bit rate only while the interface is down.
fn set(info: &CanInterfaceInfo, bitrate: u32, data: Option<u32>) -> io::Result<()> {
    // Not by the socketcan crate: it does not pass on why the kernel refuses (4.0.0).
    if info.up {
        link::set_up(info.index, false)?;
    }
    let changed = link::set_bitrate(info.index, bitrate, data);
    if changed.is_ok() || info.up {
        // Also after a refusal: what was up for others stays up.
        let up = link::set_up(info.index, true);
        return changed.and(up);
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;

    fn can0() -> CanInterfaceInfo {
        CanInterfaceInfo {
            name: "can0".into(),
            index: u32::MAX >> 1,
            kind: Some("can".into()),
            up: true,
            bitrate: Some(250_000),
            ..CanInterfaceInfo::default()
        }
    }

    fn asked(address: &str) -> CanSettings {
        address.parse().unwrap()
    }

    #[test]
    fn the_right_rate_or_no_wish_changes_nothing() {
        assert_eq!(ensure(&asked("can0"), &can0()).unwrap(), Rate::AsAsked);
        assert_eq!(ensure(&asked("can0@250000"), &can0()).unwrap(), Rate::AsAsked);
    }

    #[test]
    fn a_virtual_interface_ignores_the_rate_and_says_so() {
        let vcan = CanInterfaceInfo { kind: Some("vcan".into()), bitrate: None, ..can0() };
        let Rate::Ignored(text) = ensure(&asked("can0@500000"), &vcan).unwrap() else { panic!() };
        assert!(text.contains("virtual (vcan)") && text.contains("500000"), "{text}");
    }

    #[test]
    fn the_command_sets_both_rates() {
        let expected = "ip link set can0 down && \
             ip link set can0 up type can bitrate 500000 dbitrate 2000000 fd on";
        assert_eq!(command("can0", 500_000, Some(2_000_000)), expected);
    }

    #[test]
    fn a_rate_that_cannot_be_set_is_an_error_that_names_both_rates() {
        let error = ensure(&asked("can0@500000"), &can0()).unwrap_err().to_string();
        assert!(error.starts_with("can0 is at 250000 bit/s, not at 500000 bit/s"), "{error}");
    }
}
