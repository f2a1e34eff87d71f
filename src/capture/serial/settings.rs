//! Line settings as people write them: `19200,8N1,rtscts`.

use std::fmt;
use std::str::FromStr;

/// Parity bit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Parity {
    /// No parity bit (N).
    #[default]
    None,
    /// Even number of ones (E).
    Even,
    /// Odd number of ones (O).
    Odd,
    /// Always 1 (M). Not every driver can.
    Mark,
    /// Always 0 (S). Not every driver can.
    Space,
}

/// Stop bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StopBits {
    /// 1.
    #[default]
    One,
    /// 1.5: UARTs make them only with 5 data bits.
    OneAndHalf,
    /// 2; with 5 data bits most UARTs make 1.5 of them.
    Two,
}

/// Who may hold the other side's transmission, and how.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlowControl {
    /// Nobody.
    #[default]
    None,
    /// The RTS and CTS lines.
    RtsCts,
    /// The bytes XON (11) and XOFF (13), which then are not part of the data.
    XonXoff,
}

/// Everything that two ends of a serial line must agree on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SerialSettings {
    /// 50 to 12,000,000 bit/s.
    pub baud: u32,
    /// 5 to 8.
    pub data_bits: u8,
    /// Parity bit.
    pub parity: Parity,
    /// Stop bits.
    pub stop_bits: StopBits,
    /// Flow control.
    pub flow: FlowControl,
    /// Ask the driver to hand bytes over at once.
    pub low_latency: bool,
}

impl SerialSettings {
    /// `baud` and 8N1, no flow control.
    pub fn new(baud: u32) -> Self {
        Self {
            baud,
            data_bits: 8,
            parity: Parity::None,
            stop_bits: StopBits::One,
            flow: FlowControl::None,
            low_latency: false,
        }
    }

    /// What a byte takes on the line, in bits: start, data, parity and stop bits (1.5 as 2).
    pub fn bits_per_byte(&self) -> u32 {
        let parity = u32::from(self.parity != Parity::None);
        let stop = if self.stop_bits == StopBits::One { 1 } else { 2 };
        1 + u32::from(self.data_bits) + parity + stop
    }
}

/// Why line settings could not be read: a whole sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SettingsError(pub String);

fn refuse<T>(text: impl Into<String>) -> Result<T, SettingsError> {
    Err(SettingsError(text.into()))
}

impl FromStr for SerialSettings {
    type Err = SettingsError;

    /// `BAUD[,FORMAT][,WORD]...` with FORMAT such as `8N1` (the default) or `7E2`, and the words
    /// `none`, `rtscts`, `xonxoff`, `lowlatency`.
    fn from_str(text: &str) -> Result<Self, SettingsError> {
        let mut fields = text.split(',');
        let mut settings = Self::new(baud(fields.next().unwrap_or_default())?);
        for (index, field) in fields.enumerate() {
            match field {
                "none" => settings.flow = FlowControl::None,
                "rtscts" => settings.flow = FlowControl::RtsCts,
                "xonxoff" => settings.flow = FlowControl::XonXoff,
                "lowlatency" => settings.low_latency = true,
                format if index == 0 => settings.set_format(format)?,
                other => {
                    return refuse(format!(
                        "serial setting `{other}` is unknown; after the format only none, rtscts, \
                         xonxoff and lowlatency may follow"
                    ));
                }
            }
        }
        Ok(settings)
    }
}

fn baud(text: &str) -> Result<u32, SettingsError> {
    match text.parse() {
        Ok(baud @ 50..=12_000_000) => Ok(baud),
        Ok(_) => refuse(format!("baud rate {text} is outside 50 to 12000000 bit/s")),
        Err(_) if text.is_empty() => {
            refuse("the baud rate is missing; write it behind the port, as in 19200,8N1")
        }
        Err(_) => refuse(format!("baud rate `{text}` is not a whole number of bit/s")),
    }
}

impl SerialSettings {
    fn set_format(&mut self, text: &str) -> Result<(), SettingsError> {
        let wrong = || {
            SettingsError(format!(
                "serial format `{text}` is not data bits (5 to 8), parity (N, E, O, M, S) and stop \
                 bits (1, 1.5, 2), as in 8N1 or 7E2"
            ))
        };
        let mut characters = text.chars();
        self.data_bits = match characters.next().and_then(|c| c.to_digit(10)) {
            Some(5) => 5,
            Some(6) => 6,
            Some(7) => 7,
            Some(8) => 8,
            _ => return Err(wrong()),
        };
        self.parity = match characters.next().map(|c| c.to_ascii_uppercase()) {
            Some('N') => Parity::None,
            Some('E') => Parity::Even,
            Some('O') => Parity::Odd,
            Some('M') => Parity::Mark,
            Some('S') => Parity::Space,
            _ => return Err(wrong()),
        };
        self.stop_bits = match characters.as_str() {
            "1" => StopBits::One,
            "1.5" if self.data_bits == 5 => StopBits::OneAndHalf,
            "1.5" => {
                return refuse(format!(
                    "serial format `{text}`: UARTs make 1.5 stop bits only with 5 data bits; \
                     write 1 or 2"
                ));
            }
            "2" => StopBits::Two,
            _ => return Err(wrong()),
        };
        Ok(())
    }

    /// `8N1` and the like.
    pub fn format(&self) -> String {
        let parity = match self.parity {
            Parity::None => 'N',
            Parity::Even => 'E',
            Parity::Odd => 'O',
            Parity::Mark => 'M',
            Parity::Space => 'S',
        };
        let stop = match self.stop_bits {
            StopBits::One => "1",
            StopBits::OneAndHalf => "1.5",
            StopBits::Two => "2",
        };
        format!("{}{parity}{stop}", self.data_bits)
    }
}

impl fmt::Display for SerialSettings {
    /// The canonical form, which `from_str` reads back.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}", self.baud, self.format())?;
        match self.flow {
            FlowControl::None => {}
            FlowControl::RtsCts => f.write_str(",rtscts")?,
            FlowControl::XonXoff => f.write_str(",xonxoff")?,
        }
        if self.low_latency { f.write_str(",lowlatency") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_is_read_and_written_back_the_same() {
        for text in [
            "19200,8N1",
            "50,5N1.5",
            "12000000,8N1,lowlatency",
            "9600,7E2,rtscts",
            "1200,7M1,xonxoff,lowlatency",
            "31250,6S2",
            "250000,8O1",
        ] {
            assert_eq!(text.parse::<SerialSettings>().unwrap().to_string(), text);
        }
        let short: SerialSettings = "115200".parse().unwrap();
        assert_eq!(short, SerialSettings::new(115_200));
        assert_eq!("9600,none".parse::<SerialSettings>().unwrap().to_string(), "9600,8N1");
        assert_eq!("9600,8n1".parse::<SerialSettings>().unwrap().to_string(), "9600,8N1");
    }

    #[test]
    fn a_wrong_setting_is_refused_with_a_sentence_that_names_it() {
        for (text, part) in [
            ("", "baud rate is missing"),
            ("8N1", "baud rate `8N1`"),
            ("49", "49 is outside 50 to 12000000"),
            ("12000001,8N1", "outside"),
            ("9600,9N1", "`9N1`"),
            ("9600,8X1", "`8X1`"),
            ("9600,8N3", "`8N3`"),
            ("9600,8N", "`8N`"),
            ("9600,8N1.5", "only with 5 data bits"),
            ("9600,8N1,fast", "`fast` is unknown"),
            ("9600,8N1,8N1", "`8N1` is unknown"),
            ("9600,", "serial format ``"),
            ("9600,\u{e9}N1", "serial format"),
        ] {
            let error = text.parse::<SerialSettings>().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
