//! The address of a SocketCAN interface: `can0`, `can0@500000/2000000,123:7FF,#FFFFFFFF`.
//!
//! Filters are candump's (can-utils, `candump.c`), because that is what this field types.

use std::str::FromStr;

use crate::capture::CaptureError;

/// `CAN_EFF_FLAG` of `linux/can.h`: 29-bit identifier.
const EXTENDED: u32 = 0x8000_0000;
/// `CAN_ERR_FLAG`: error frame. Error frames are filtered by their own mask.
const ERROR: u32 = 0x2000_0000;
/// `CAN_INV_FILTER` of `linux/can/raw.h`: the filter matches what does not match.
const INVERTED: u32 = 0x2000_0000;
/// `CAN_RAW_FILTER_MAX` of `linux/can/raw.h`.
const FILTERS_MAX: usize = 512;
/// `CAN_BITRATE_MAX` of ISO 11898-1 for classic CAN and the arbitration phase of CAN FD, bit/s.
const BITRATE_MAX: u32 = 1_000_000;
/// Faster than any controller's data phase, bit/s.
const DATA_BITRATE_MAX: u32 = 20_000_000;
/// `IFNAMSIZ` without the closing NUL, bytes.
const NAME_MAX: usize = 15;

/// A kernel filter: a frame passes if `received id & mask == id & mask`. Both carry the flags of
/// `linux/can.h` (`CAN_EFF_FLAG`, `CAN_RTR_FLAG`), `id` also `CAN_INV_FILTER`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFilter {
    /// Identifier and flags.
    pub id: u32,
    /// The bits that are compared.
    pub mask: u32,
}

/// What an address says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CanSettings {
    /// Name of the interface.
    pub interface: String,
    /// Nominal bit rate asked for, 1 to 1,000,000 bit/s.
    pub bitrate: Option<u32>,
    /// Bit rate of the CAN FD data phase asked for, 1 to 20,000,000 bit/s.
    pub data_bitrate: Option<u32>,
    /// Which frames are recorded: those that match any of these; all frames if there are none.
    pub filters: Vec<CanFilter>,
    /// Only frames that match all filters.
    pub join: bool,
    /// Which classes of error frames are recorded, where the address says so.
    pub error_mask: Option<u32>,
    /// The filters as they were written, for the recording's metadata.
    pub filter_text: String,
}

impl FromStr for CanSettings {
    type Err = CaptureError;

    /// Parses `INTERFACE[@BITRATE[/DATA_BITRATE]][,FILTER]...`.
    ///
    /// Each FILTER is, in hexadecimal without `0x`: `ID:MASK` (matching frames), `ID~MASK` or
    /// `~ID:MASK` (all others), `#MASK` (classes of error frames) or `j` (frames must match all
    /// filters, not one). An ID of 8 digits is a 29-bit identifier, a shorter one is compared as
    /// it stands, so that with the mask `7FF` it matches identifiers of both kinds.
    ///
    /// # Errors
    /// A sentence that names the part that is wrong and what is expected.
    fn from_str(text: &str) -> Result<Self, CaptureError> {
        let (place, filters) = match text.split_once(',') {
            Some((place, filters)) => (place, Some(filters)),
            None => (text, None),
        };
        let (interface, rates) = match place.split_once('@') {
            Some((interface, rates)) => (interface, Some(rates)),
            None => (place, None),
        };
        let mut settings = Self { interface: interface_name(interface)?, ..Self::default() };
        if let Some(rates) = rates {
            settings.set_rates(rates)?;
        }
        if let Some(filters) = filters {
            filters.clone_into(&mut settings.filter_text);
            for filter in filters.split(',') {
                settings.add_filter(filter)?;
            }
        }
        if settings.filters.len() > FILTERS_MAX {
            let count = settings.filters.len();
            return refuse(format!("{count} filters: the kernel takes at most {FILTERS_MAX}"));
        }
        Ok(settings)
    }
}

impl CanSettings {
    fn set_rates(&mut self, text: &str) -> Result<(), CaptureError> {
        let (nominal, data) = match text.split_once('/') {
            Some((nominal, data)) => (nominal, Some(data)),
            None => (text, None),
        };
        self.bitrate = Some(rate("bit rate", nominal, BITRATE_MAX)?);
        self.data_bitrate =
            data.map(|data| rate("data bit rate", data, DATA_BITRATE_MAX)).transpose()?;
        Ok(())
    }

    fn add_filter(&mut self, text: &str) -> Result<(), CaptureError> {
        if text.eq_ignore_ascii_case("j") {
            self.join = true;
        } else if let Some(mask) = text.strip_prefix('#') {
            self.error_mask = Some(hex(mask, text)?);
        } else if let Some((id, mask)) = text.strip_prefix('~').and_then(|t| t.split_once(':')) {
            self.filters.push(filter(id, mask, INVERTED, text)?);
        } else if let Some((id, mask)) = text.split_once(':') {
            self.filters.push(filter(id, mask, 0, text)?);
        } else if let Some((id, mask)) = text.split_once('~') {
            self.filters.push(filter(id, mask, INVERTED, text)?);
        } else {
            return refuse(format!("filter '{text}': {FILTER_FORMS}"));
        }
        Ok(())
    }
}

const FILTER_FORMS: &str =
    "expected ID:MASK, ID~MASK, #ERRORMASK or j, in hexadecimal such as 123:7FF";

fn filter(id: &str, mask: &str, inverted: u32, text: &str) -> Result<CanFilter, CaptureError> {
    let extended = if id.len() == 8 { EXTENDED } else { 0 };
    Ok(CanFilter {
        id: hex(id, text)? | extended | inverted,
        // candump does the same: error frames pass by the error mask only.
        mask: hex(mask, text)? & !ERROR,
    })
}

fn hex(digits: &str, text: &str) -> Result<u32, CaptureError> {
    // from_str_radix would take a sign too.
    let plain = digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    match u32::from_str_radix(digits, 16) {
        Ok(number) if plain => Ok(number),
        _ => refuse(format!(
            "filter '{text}': '{digits}' is not a hexadecimal number of 1 to 8 digits; \
             {FILTER_FORMS}"
        )),
    }
}

fn rate(what: &str, text: &str, most: u32) -> Result<u32, CaptureError> {
    match text.parse() {
        Ok(rate) if (1..=most).contains(&rate) && !text.starts_with('+') => Ok(rate),
        _ => refuse(format!("{what} '{text}': expected a number of bit/s from 1 to {most}")),
    }
}

fn interface_name(text: &str) -> Result<String, CaptureError> {
    let usable = |c: char| !c.is_whitespace() && !c.is_control() && c != '/' && c != ':';
    if text.is_empty() {
        return refuse("a CAN address begins with the name of an interface, such as can0".into());
    }
    if text == "any" {
        return refuse(
            "'any' stands for several interfaces: name each as a bus of its own, such as \
             can0 can1"
                .into(),
        );
    }
    if text.len() > NAME_MAX || text == "." || text == ".." || !text.chars().all(usable) {
        return refuse(format!(
            "'{}' cannot be the name of a CAN interface: expected 1 to {NAME_MAX} letters and \
             digits, such as can0",
            text.escape_debug()
        ));
    }
    Ok(text.to_owned())
}

fn refuse<T>(sentence: String) -> Result<T, CaptureError> {
    Err(CaptureError(sentence))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> CanSettings {
        text.parse().unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    fn refusal(text: &str) -> String {
        text.parse::<CanSettings>().unwrap_err().to_string()
    }

    #[test]
    fn a_name_alone_records_everything() {
        let expected = CanSettings { interface: "can0".into(), ..CanSettings::default() };
        assert_eq!(parse("can0"), expected);
    }

    #[test]
    fn bit_rates() {
        let settings = parse("can0@500000/2000000,123:7FF");
        assert_eq!((settings.bitrate, settings.data_bitrate), (Some(500_000), Some(2_000_000)));
        assert_eq!(parse("can0@125000").data_bitrate, None);
        for (text, wrong) in [
            ("can0@", "bit rate ''"),
            ("can0@500k", "bit rate '500k'"),
            ("can0@0", "from 1 to 1000000"),
            ("can0@+5", "bit rate '+5'"),
            ("can0@1000001", "bit rate '1000001'"),
            ("can0@500000/", "data bit rate ''"),
            ("can0@500000/99999999999", "data bit rate '99999999999'"),
        ] {
            assert!(refusal(text).contains(wrong), "{text}: {}", refusal(text));
        }
    }

    // Each pair as candump hands it to the kernel (strace of can-utils 2020.11).
    #[test]
    fn filters_are_candumps() {
        let one = |text: &str| parse(&format!("can0,{text}")).filters[0];
        assert_eq!(one("123:7FF"), CanFilter { id: 0x123, mask: 0x7FF });
        assert_eq!(one("0:0"), CanFilter { id: 0, mask: 0 });
        assert_eq!(one("123:C00007FF"), CanFilter { id: 0x123, mask: 0xC000_07FF });
        assert_eq!(one("12345678:DFFFFFFF"), CanFilter { id: 0x9234_5678, mask: 0xDFFF_FFFF });
        assert_eq!(one("00000123:1fffffff"), CanFilter { id: 0x8000_0123, mask: 0x1FFF_FFFF });
        assert_eq!(one("1234567:1FFFFFFF"), CanFilter { id: 0x123_4567, mask: 0x1FFF_FFFF });
        assert_eq!(one("456~7FF"), CanFilter { id: 0x2000_0456, mask: 0x7FF });
        assert_eq!(one("~456:7FF"), one("456~7FF"));
        assert_eq!(one("12345678~FFFFFFFF"), CanFilter { id: 0xB234_5678, mask: 0xDFFF_FFFF });
    }

    #[test]
    fn filters_error_mask_and_join_together() {
        let settings = parse("vcan2,123:7FF,400~7F0,#1F,J");
        assert_eq!((settings.filters.len(), settings.error_mask), (2, Some(0x1F)));
        assert!(settings.join);
        assert_eq!(settings.filter_text, "123:7FF,400~7F0,#1F,J");
    }

    #[test]
    fn wrong_filters_are_named() {
        for text in ["", "123", "123:", ":7FF", "0x123:7FF", "123:7FG", "123456789:0", "#", "-1:0"]
        {
            let refusal = refusal(&format!("can0,{text}"));
            assert!(refusal.starts_with(&format!("filter '{text}'")), "{text}: {refusal}");
            assert!(refusal.contains("expected ID:MASK"), "{refusal}");
        }
        let many = format!("can0{}", ",1:7FF".repeat(513));
        assert!(refusal(&many).contains("513 filters"));
    }

    #[test]
    fn wrong_names_are_named() {
        assert!(refusal("@500000").contains("begins with the name"));
        assert!(refusal("any,0:0").contains("bus of its own"));
        for name in ["averyveryverylongname", "a b", "a/b", "..", "x\u{1b}[2J"] {
            assert!(refusal(name).contains("cannot be the name"), "{name}");
            assert!(!refusal(name).contains('\u{1b}'));
        }
    }
}
