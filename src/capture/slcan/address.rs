//! Addresses of slcan adapters, and the bit rates the protocol has.

use std::path::PathBuf;

use crate::capture::serial::SettingsError;

/// `S0` to `S8` of the CANUSB manual, bit/s. `S7` is 800k there and in the Linux driver; a few
/// firmwares make 750k of it, which no adapter tells.
const RATES: [u32; 9] =
    [10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];

/// Rates of the CAN FD data phase (`Y`), bit/s, as in the CANable 2 firmware and its relatives.
const DATA_RATES: [(u32, u8); 5] =
    [(1_000_000, 1), (2_000_000, 2), (4_000_000, 4), (5_000_000, 5), (8_000_000, 8)];

/// One adapter: where it is and how its bus runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SlcanAddress {
    /// The adapter's serial port.
    pub path: PathBuf,
    /// Bit rate of the CAN bus, bit/s.
    pub bitrate: u32,
    /// Bit rate of the data phase of CAN FD, bit/s.
    pub data_bitrate: Option<u32>,
    /// Baud rate of the serial port; USB adapters do not care.
    pub baud: u32,
    /// Open the bus listening only (`L`): not even acknowledging frames. Without it the bus is
    /// opened normally (`O`), since many adapters have no `L`, and on a bus with one other node
    /// nothing is ever acknowledged if the recorder does not.
    pub listen: bool,
    /// Have the adapter stamp frames (`Z1`). CANUSB adapters keep that in their EEPROM, which is
    /// why it is not done unasked. Stamps that come anyway are used.
    pub stamps: bool,
}

impl SlcanAddress {
    /// Reads `slcan:PATH@BITRATE[/DATA_BITRATE][,listen][,stamps][,BAUD]`. `None` without the prefix.
    pub fn parse(text: &str) -> Option<Result<Self, SettingsError>> {
        Some(parse(text.strip_prefix("slcan:")?))
    }

    /// The bus's name when the user gives none.
    pub fn default_name(&self) -> String {
        self.path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// The commands that set up the closed bus, in their order, without CR.
    pub(crate) fn set_up_commands(&self) -> Vec<String> {
        let mut commands = Vec::new();
        if let Some(index) = RATES.iter().position(|&r| r == self.bitrate) {
            commands.push(format!("S{index}"));
        }
        if let Some((_, digit)) = DATA_RATES.iter().find(|(r, _)| Some(*r) == self.data_bitrate) {
            commands.push(format!("Y{digit}"));
        }
        if self.stamps {
            commands.push("Z1".to_owned());
        }
        commands
    }
}

fn parse(text: &str) -> Result<SlcanAddress, SettingsError> {
    let mut words = text.split(',');
    let head = words.next().unwrap_or_default();
    // Names in /dev/serial may contain an at sign: the last one counts.
    let Some((path, rates)) = head.rsplit_once('@').filter(|(path, _)| !path.is_empty()) else {
        return Err(SettingsError(format!(
            "slcan adapter `{text}` lacks the bit rate of its bus; write it as \
             slcan:/dev/ttyACM0@500000"
        )));
    };
    let (nominal, data) = match rates.split_once('/') {
        Some((nominal, data)) => (nominal, Some(data)),
        None => (rates, None),
    };
    let bitrate = rate(nominal, &RATES, "bit rate")?;
    let data_bitrate = match data {
        Some(data) => Some(rate(data, &DATA_RATES.map(|(r, _)| r), "data bit rate")?),
        None => None,
    };
    let mut address = SlcanAddress {
        path: path.into(),
        bitrate,
        data_bitrate,
        baud: 115_200,
        listen: false,
        stamps: false,
    };
    for word in words {
        match (word, word.parse()) {
            ("listen", _) => address.listen = true,
            ("stamps", _) => address.stamps = true,
            (_, Ok(baud @ 50..=12_000_000)) => address.baud = baud,
            _ => {
                return Err(SettingsError(format!(
                    "slcan setting `{word}` is unknown; only listen, stamps and the baud rate of \
                     the serial port (50 to 12000000) may follow the bit rate"
                )));
            }
        }
    }
    Ok(address)
}

fn rate(text: &str, known: &[u32], what: &str) -> Result<u32, SettingsError> {
    text.parse().ok().filter(|r| known.contains(r)).ok_or_else(|| {
        let known: Vec<_> = known.iter().map(u32::to_string).collect();
        SettingsError(format!("slcan has no {what} `{text}`; it has {}", known.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read() {
        let plain = SlcanAddress::parse("slcan:/dev/ttyACM0@500000").unwrap().unwrap();
        assert_eq!((plain.baud, plain.listen, plain.data_bitrate), (115_200, false, None));
        assert_eq!(plain.default_name(), "ttyACM0");
        assert_eq!(plain.set_up_commands(), ["S6"]);
        let text = "slcan:/dev/a@b@1000000/5000000,listen,stamps,3000000";
        let full = SlcanAddress::parse(text).unwrap().unwrap();
        assert_eq!(
            (full.path.to_str(), full.baud, full.listen),
            (Some("/dev/a@b"), 3_000_000, true)
        );
        assert_eq!(full.set_up_commands(), ["S8", "Y5", "Z1"]);
        assert_eq!(SlcanAddress::parse("/dev/ttyACM0,9600"), None);
    }

    #[test]
    fn a_wrong_address_is_refused_with_what_there_is() {
        for (text, part) in [
            ("slcan:/dev/ttyACM0", "lacks the bit rate"),
            ("slcan:@500000", "lacks the bit rate"),
            ("slcan:/dev/x@750000", "no bit rate `750000`; it has 10000, 20000"),
            ("slcan:/dev/x@500000/3000000", "no data bit rate `3000000`; it has 1000000, 2000000"),
            ("slcan:/dev/x@500000,loud", "`loud` is unknown"),
            ("slcan:/dev/x@500000,8N1", "`8N1` is unknown"),
        ] {
            let error = SlcanAddress::parse(text).unwrap().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
