//! Where a recorded bus goes, as written on the command line: `BUS=ADDRESS`.

use std::path::PathBuf;

use super::ReplayError;
use crate::capture::serial::{SerialAddress, SerialSettings};
use crate::capture::slcan::SlcanAddress;
use crate::capture::socketcan::CanSettings;

/// A recorded bus and where it is played to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TargetSpec {
    /// The bus's name in the recording.
    pub bus: String,
    /// The address, as it was written.
    pub text: String,
    /// Where that is.
    pub address: TargetAddress,
}

/// Something that can be played to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TargetAddress {
    /// A SocketCAN interface, by name.
    Can(String),
    /// A CAN adapter on a serial line.
    Slcan(SlcanAddress),
    /// A serial port.
    Port {
        /// The device.
        path: PathBuf,
        /// Its line.
        settings: SerialSettings,
    },
    /// A pseudo-terminal that is made for the purpose and linked here.
    Pty(PathBuf),
    /// Lines of text on stdout.
    Trace,
}

impl TargetSpec {
    /// Reads `BUS=ADDRESS`.
    pub fn parse(text: &str) -> Result<Self, ReplayError> {
        let Some((bus, address)) = text.split_once('=').filter(|(bus, _)| !bus.is_empty()) else {
            return Err(ReplayError(format!(
                "--to {text}: write it as BUS=ADDRESS, e.g. can0=vcan0, rect=pty:/tmp/ttyRECT or \
                 can0=trace:"
            )));
        };
        let parsed = TargetAddress::parse(address)
            .map_err(|why| ReplayError(format!("--to {text}: {why}")))?;
        Ok(Self { bus: bus.to_owned(), text: address.to_owned(), address: parsed })
    }
}

impl TargetAddress {
    fn parse(text: &str) -> Result<Self, String> {
        if text == "trace:" {
            return Ok(Self::Trace);
        }
        if let Some(adapter) = SlcanAddress::parse(text) {
            return match adapter {
                Ok(address) if address.listen => {
                    Err("an adapter that only listens cannot send; leave out `listen`".to_owned())
                }
                other => other.map(Self::Slcan).map_err(|error| error.to_string()),
            };
        }
        if let Some(serial) = SerialAddress::parse(text) {
            return match serial.map_err(|error| error.to_string())? {
                SerialAddress::Port { path, settings } => Ok(Self::Port { path, settings }),
                SerialAddress::Pty { link } => Ok(Self::Pty(link)),
                SerialAddress::Tap { .. } | SerialAddress::Bridge { .. } => {
                    Err("a tap or bridge can only be recorded; name one port to play to".to_owned())
                }
            };
        }
        if let Some((kind, _)) = text.split_once(':').filter(|(kind, _)| !kind.contains(',')) {
            return Err(format!(
                "\"{kind}:\" is nothing that can be played to; there are a CAN interface, slcan:, \
                 a serial port, pty: and trace:"
            ));
        }
        let settings: CanSettings = text.parse().map_err(|error| format!("{error}"))?;
        if settings != (CanSettings { interface: settings.interface.clone(), ..Default::default() })
        {
            return Err(format!(
                "bit rates and filters cannot stand here; name the interface only, as {}, set its \
                 bit rate with \"ip link\" and filter with --filter",
                settings.interface
            ));
        }
        Ok(Self::Can(settings.interface))
    }

    /// The name that `--transmit-on` has to repeat: the interface, or the device's path.
    pub fn name(&self) -> String {
        match self {
            Self::Can(interface) => interface.clone(),
            Self::Slcan(SlcanAddress { path, .. }) | Self::Port { path, .. } | Self::Pty(path) => {
                path.display().to_string()
            }
            Self::Trace => "trace:".to_owned(),
        }
    }

    /// True if serial bytes can go there.
    pub fn takes_serial(&self) -> bool {
        matches!(self, Self::Port { .. } | Self::Pty(_) | Self::Trace)
    }

    /// True if CAN frames can go there.
    pub fn takes_can(&self) -> bool {
        matches!(self, Self::Can(_) | Self::Slcan(_) | Self::Trace)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<TargetAddress, String> {
        TargetSpec::parse(text).map(|spec| spec.address).map_err(|error| error.0)
    }

    #[test]
    fn each_form_is_read() {
        assert_eq!(parse("can0=vcan0"), Ok(TargetAddress::Can("vcan0".to_owned())));
        assert_eq!(parse("can0=trace:"), Ok(TargetAddress::Trace));
        assert_eq!(parse("rect=pty:/tmp/a=b"), Ok(TargetAddress::Pty("/tmp/a=b".into())));
        let Ok(TargetAddress::Port { path, .. }) = parse("rect=/dev/ttyUSB0,19200,8N1") else {
            panic!()
        };
        assert_eq!(path, PathBuf::from("/dev/ttyUSB0"));
        assert!(matches!(parse("a=slcan:/dev/ttyACM0@500000"), Ok(TargetAddress::Slcan(_))));
    }

    #[test]
    fn what_cannot_be_played_to_is_refused() {
        for (text, part) in [
            ("vcan0", "BUS=ADDRESS"),
            ("=vcan0", "BUS=ADDRESS"),
            ("a=sim:hmi-can", "\"sim:\" is nothing"),
            ("a=tap:/dev/a+/dev/b,9600", "only be recorded"),
            ("a=slcan:/dev/ttyACM0@500000,listen", "only listens"),
            ("a=can0@500000", "name the interface only"),
            ("a=can0,123:7FF", "name the interface only"),
            ("a=/dev/ttyUSB0", "baud rate"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
