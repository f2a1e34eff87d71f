//! Addresses of serial buses, as written on the command line.

use std::path::{Path, PathBuf};

use super::settings::{SerialSettings, SettingsError};
use super::{Bridge, Listen, PtySource};
use crate::capture::{CaptureError, Source};

/// One serial bus: where it is and how its line is set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SerialAddress {
    /// `/dev/ttyUSB0,19200,8N1`: one port, receive only.
    Port {
        /// The device.
        path: PathBuf,
        /// Its line.
        settings: SerialSettings,
    },
    /// `tap:/dev/ttyUSB0+/dev/ttyUSB1,19200,8N1`: two ports, each wired to one line of a link.
    Tap {
        /// Hears the device.
        device: PathBuf,
        /// Hears the host.
        host: PathBuf,
        /// Both lines.
        settings: SerialSettings,
    },
    /// `bridge:/dev/ttyUSB0,19200,8N1@PATH`: the application opens PATH, bytes pass on.
    Bridge {
        /// The real device.
        path: PathBuf,
        /// Its line.
        settings: SerialSettings,
        /// What the application opens.
        link: PathBuf,
    },
    /// `pty:PATH`: a pseudo-terminal that somebody writes to.
    Pty {
        /// What the writer opens.
        link: PathBuf,
    },
}

impl SerialAddress {
    /// Reads an address. `None` if it has none of the serial forms: then it is something else's.
    ///
    /// A plain port is known by its leading `/`. The first comma ends the path, so a device whose
    /// path has a comma needs a symlink without one.
    pub fn parse(text: &str) -> Option<Result<Self, SettingsError>> {
        if let Some(rest) = text.strip_prefix("tap:") {
            Some(tap(rest))
        } else if let Some(rest) = text.strip_prefix("bridge:") {
            Some(bridge(rest))
        } else if let Some(rest) = text.strip_prefix("pty:") {
            Some(pty(rest))
        } else if text.starts_with('/') {
            Some(port(text).map(|(path, settings)| Self::Port { path, settings }))
        } else {
            None
        }
    }

    /// Opens the bus, so that a wrong name or missing right shows before anything is recorded.
    pub fn open(self) -> Result<Box<dyn Source>, CaptureError> {
        Ok(match self {
            Self::Port { path, settings } => Box::new(Listen::port(path, settings)?),
            Self::Tap { device, host, settings } => Box::new(Listen::tap(device, host, settings)?),
            Self::Bridge { path, settings, link } => Box::new(Bridge::open(path, settings, link)?),
            Self::Pty { link } => Box::new(PtySource::open(link)?),
        })
    }

    /// True unless a device of it is missing.
    pub fn is_there(&self) -> bool {
        match self {
            Self::Port { path, .. } | Self::Bridge { path, .. } => path.exists(),
            Self::Tap { device, host, .. } => device.exists() && host.exists(),
            Self::Pty { .. } => true,
        }
    }

    /// The bus's name when the user gives none: the last part of the path that stands for it.
    pub fn default_name(&self) -> String {
        let path = match self {
            Self::Port { path, .. } | Self::Bridge { path, .. } => path,
            Self::Tap { device, .. } => device,
            Self::Pty { link } => link,
        };
        path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    }
}

fn refuse<T>(text: String) -> Result<T, SettingsError> {
    Err(SettingsError(text))
}

/// `PATH,BAUD,...`.
pub(crate) fn port(text: &str) -> Result<(PathBuf, SerialSettings), SettingsError> {
    let Some((path, settings)) = text.split_once(',') else {
        return refuse(format!(
            "serial port `{text}` lacks its baud rate; write it as {text},19200,8N1"
        ));
    };
    if path.is_empty() {
        return refuse(format!("serial address `{text}` has no port before the first comma"));
    }
    match settings.parse() {
        Ok(settings) => Ok((PathBuf::from(path), settings)),
        Err(SettingsError(why)) => refuse(format!("serial port {path}: {why}")),
    }
}

fn tap(text: &str) -> Result<SerialAddress, SettingsError> {
    let (paths, settings) = port(text)?;
    let paths = paths.to_string_lossy().into_owned();
    // Names in /dev/serial/by-id may contain a plus, but not one before a slash.
    let Some((device, host)) = paths.split_once("+/") else {
        return refuse(format!(
            "tap `{paths}` needs two ports, the device's line first; write it as \
             tap:/dev/ttyUSB0+/dev/ttyUSB1,19200,8N1"
        ));
    };
    let (device, host) = (PathBuf::from(device), Path::new("/").join(host));
    if device == host {
        return refuse(format!("tap `{paths}` names the same port twice; it needs two"));
    }
    Ok(SerialAddress::Tap { device, host, settings })
}

fn bridge(text: &str) -> Result<SerialAddress, SettingsError> {
    let comma = text.find(',').unwrap_or(0);
    // Names in /dev/serial may contain an at sign, settings cannot.
    let Some((settings, link)) = text[comma..].split_once('@').filter(|(_, l)| !l.is_empty())
    else {
        return refuse(format!(
            "bridge `{text}` lacks the path for the application; write it as \
             bridge:/dev/ttyUSB0,19200,8N1@/tmp/ttyAPP"
        ));
    };
    let (path, settings) = port(&text[..comma + settings.len()])?;
    Ok(SerialAddress::Bridge { path, settings, link: PathBuf::from(link) })
}

fn pty(text: &str) -> Result<SerialAddress, SettingsError> {
    if text.is_empty() {
        return refuse("pty: needs the path to make, as in pty:/tmp/ttyAPP".to_owned());
    }
    Ok(SerialAddress::Pty { link: PathBuf::from(text) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ok(text: &str) -> SerialAddress {
        SerialAddress::parse(text).unwrap().unwrap()
    }

    #[test]
    fn each_form_is_read() {
        let settings: SerialSettings = "19200,7E1,rtscts".parse().unwrap();
        let usb0 = PathBuf::from("/dev/ttyUSB0");
        let port = ok("/dev/ttyUSB0,19200,7E1,rtscts");
        assert_eq!(port, SerialAddress::Port { path: usb0.clone(), settings });
        assert_eq!(port.default_name(), "ttyUSB0");
        let tap = ok("tap:/dev/serial/by-id/usb-a+b-if00+/dev/ttyUSB1,19200,7E1,rtscts");
        let device = PathBuf::from("/dev/serial/by-id/usb-a+b-if00");
        let host = PathBuf::from("/dev/ttyUSB1");
        assert_eq!(tap, SerialAddress::Tap { device, host, settings });
        let bridge = ok("bridge:/dev/ttyUSB0,19200,7E1,rtscts@/tmp/a@b");
        let link = PathBuf::from("/tmp/a@b");
        assert_eq!(bridge, SerialAddress::Bridge { path: usb0, settings, link });
        assert_eq!(bridge.default_name(), "ttyUSB0");
        assert_eq!(ok("pty:/tmp/dev").default_name(), "dev");
    }

    #[test]
    fn other_buses_are_left_to_others() {
        for text in ["can0", "vcan0@500000", "sim:hmi-can", "slcan:/dev/ttyACM0@500000", ""] {
            assert_eq!(SerialAddress::parse(text), None, "{text}");
        }
    }

    #[test]
    fn a_wrong_address_is_refused_with_the_right_form() {
        for (text, part) in [
            ("/dev/ttyUSB0", "write it as /dev/ttyUSB0,19200,8N1"),
            ("/dev/ttyUSB0,8N1", "/dev/ttyUSB0: baud rate `8N1`"),
            ("tap:/dev/ttyUSB0,9600", "needs two ports"),
            ("tap:/dev/ttyUSB0+/dev/ttyUSB0,9600", "twice"),
            ("bridge:/dev/ttyUSB0,9600", "path for the application"),
            ("bridge:/dev/ttyUSB0,9600@", "path for the application"),
            ("bridge:/dev/ttyUSB0@/tmp/x", "lacks its baud rate"),
            ("bridge:,9600@/tmp/x", "no port before"),
            ("pty:", "needs the path"),
        ] {
            let error = SerialAddress::parse(text).unwrap().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
