//! Opens a port with all its settings, for the first time or again.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use nix::sys::termios::ControlFlags;
use serialport::{DataBits, SerialPortBuilder};

use super::identity::{hardware, holders, stable_name};
use super::settings::{FlowControl, Parity, SerialSettings, StopBits};
use super::trouble::cannot_open;
use crate::capture::CaptureError;
use crate::frame::Level;
use crate::sys::tty::Tty;

/// What a port is opened for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// To hear only: nothing is ever written, closing leaves DTR and RTS as they are.
    Listen,
    /// To pass an application's bytes on.
    Talk,
    /// To talk to an adapter that speaks a protocol of its own, or as a simulated device; line
    /// errors say nothing there.
    Adapter,
}

/// A port that was open once: enough to open it again.
#[derive(Clone, Debug)]
pub(crate) struct PortSpec {
    /// As the user gave it.
    pub path: PathBuf,
    /// Where to look for it after it went away.
    pub stable: PathBuf,
    pub settings: SerialSettings,
    pub purpose: Use,
}

/// An open port, and what a person should know about it.
#[derive(Debug)]
pub(crate) struct Opened {
    pub tty: Tty,
    /// Whether error marks are in the stream.
    pub marked: bool,
    pub notes: Vec<(Level, String)>,
}

impl PortSpec {
    /// Opens `path` for the first time.
    pub fn open_first(
        path: PathBuf,
        settings: SerialSettings,
        purpose: Use,
    ) -> Result<(Self, Opened), CaptureError> {
        if purpose == Use::Listen && settings.flow == FlowControl::XonXoff {
            return Err(CaptureError(format!(
                "serial port {}: xonxoff would make a port that only listens send XOFF; leave it \
                 out, XON and XOFF are then recorded as bytes",
                path.display()
            )));
        }
        let stable = stable_name(&path);
        let spec = Self { path, stable, settings, purpose };
        let opened = spec.open_at(&spec.path)?;
        Ok((spec, opened))
    }

    /// Opens the same port again under its stable name.
    pub fn open_again(&self) -> Result<Opened, CaptureError> {
        self.open_at(&self.stable)
    }

    fn open_at(&self, path: &Path) -> Result<Opened, CaptureError> {
        let tty = Tty::open(&self.builder(path))
            .map_err(|error| CaptureError(cannot_open(path, &error)))?;
        let pseudo = tty.is_pseudo();
        let mut notes = Vec::new();
        if !pseudo {
            self.set_line(&tty).map_err(|error| self.unsupported(&error.to_string()))?;
            self.check_line(&tty)?;
        }
        if self.settings.low_latency && tty.set_low_latency().is_err() {
            let text = format!("{}: the driver has no low-latency setting", path.display());
            notes.push((Level::Warning, text));
        }
        for other in holders(path).into_iter().filter(|other| !other.made(path)) {
            let text = format!(
                "{} is also open in process {} ({}), which takes a share of the bytes; close it",
                path.display(),
                other.pid,
                other.name
            );
            notes.push((Level::Warning, text));
        }
        let marked = !pseudo && self.purpose != Use::Adapter;
        Ok(Opened { tty, marked, notes })
    }

    fn builder(&self, path: &Path) -> SerialPortBuilder {
        let SerialSettings { baud, data_bits, parity, stop_bits, flow, .. } = self.settings;
        serialport::new(path.to_string_lossy(), baud)
            .data_bits(match data_bits {
                5 => DataBits::Five,
                6 => DataBits::Six,
                7 => DataBits::Seven,
                _ => DataBits::Eight,
            })
            .parity(match parity {
                Parity::Even => serialport::Parity::Even,
                Parity::Odd => serialport::Parity::Odd,
                // Mark and space are set afterwards.
                Parity::None | Parity::Mark | Parity::Space => serialport::Parity::None,
            })
            .stop_bits(match stop_bits {
                StopBits::One => serialport::StopBits::One,
                // With 5 data bits, CSTOPB means 1.5.
                StopBits::OneAndHalf | StopBits::Two => serialport::StopBits::Two,
            })
            .flow_control(match flow {
                FlowControl::None => serialport::FlowControl::None,
                FlowControl::RtsCts => serialport::FlowControl::Hardware,
                FlowControl::XonXoff => serialport::FlowControl::Software,
            })
    }

    /// What serialport cannot set. A pseudo-terminal has no line, so none of this.
    fn set_line(&self, tty: &Tty) -> io::Result<()> {
        if let Parity::Mark | Parity::Space = self.settings.parity {
            tty.set_sticky_parity(self.settings.parity == Parity::Mark)?;
        }
        if self.purpose == Use::Listen {
            tty.hang_up_on_close(false)?;
        }
        if self.purpose != Use::Adapter {
            tty.mark_errors()?;
        }
        // What came before this line is without marks, and maybe at another rate.
        tty.discard_input()
    }

    /// Drivers replace what they cannot do instead of refusing it.
    fn check_line(&self, tty: &Tty) -> Result<(), CaptureError> {
        let wanted = self.settings.baud;
        if let Some(actual) = tty.actual_baud
            // A UART's divider rarely hits a rate exactly; beyond 3 % bytes break.
            && u64::from(actual.abs_diff(wanted)) * 100 > u64::from(wanted) * 3
        {
            return Err(self.unsupported(&format!("it runs at {actual} bit/s instead")));
        }
        let size = match self.settings.data_bits {
            5 => ControlFlags::CS5,
            6 => ControlFlags::CS6,
            7 => ControlFlags::CS7,
            _ => ControlFlags::CS8,
        };
        let mut format = size;
        format.set(ControlFlags::PARENB, self.settings.parity != Parity::None);
        format
            .set(ControlFlags::PARODD, matches!(self.settings.parity, Parity::Odd | Parity::Mark));
        format.set(
            ControlFlags::CMSPAR,
            matches!(self.settings.parity, Parity::Mark | Parity::Space),
        );
        format.set(ControlFlags::CSTOPB, self.settings.stop_bits != StopBits::One);
        match tty.format_flags() {
            Ok(actual) if actual != format => Err(self.unsupported("it keeps another format")),
            _ => Ok(()),
        }
    }

    fn unsupported(&self, why: &str) -> CaptureError {
        CaptureError(format!(
            "serial port {} cannot be set to {}: {why}; choose settings that its hardware has",
            self.path.display(),
            self.settings
        ))
    }

    /// What goes into the metadata of a recording.
    pub fn facts(&self) -> BTreeMap<String, String> {
        let mut facts = hardware(&self.path);
        facts.insert("port".to_owned(), self.path.display().to_string());
        facts.insert("settings".to_owned(), self.settings.to_string());
        if self.stable != self.path {
            facts.insert("stable_name".to_owned(), self.stable.display().to_string());
        }
        facts
    }
}
