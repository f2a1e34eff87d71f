//! The controller's settings: read out as fifteen packets, written one by one.

use super::{device, frame};
use crate::frame::{CanFlags, CanFrame};
use crate::simulate::random::Random;
use crate::simulate::station::SITE;

/// Number of settings, PARAM_ID 0 to 0x28.
pub const COUNT: u8 = 0x29;

/// What a setting is, with the values that the controller accepts (HMI CAN protocol, section 5.4).
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// 15 characters in two halves of 8 bytes.
    Text,
    /// One byte.
    Byte(u16, u16),
    /// Two bytes, low byte first.
    Word(u16, u16),
    /// Day, month, year low byte first.
    Date,
    /// Starter time of each of eight attempts, 1 to 6 s.
    Starts,
    /// An angle, f64, 0 to this many degrees.
    Degrees(f64),
}

/// Kind and factory value of every setting, by PARAM_ID. Times in seconds.
#[rustfmt::skip]
const PARAMETERS: [(Kind, u16); COUNT as usize] = [
    (Kind::Text, 0), (Kind::Text, 0), (Kind::Text, 0),
    (Kind::Byte(0, 2), 2),          // 0x03 mode of the system: 0 test, 1 backup, 2 mixed
    (Kind::Byte(0, 1), 1),          // 0x04 a directory of logs for each month
    (Kind::Date, 0),                // 0x05 last charge
    (Kind::Byte(0, 1), 1), (Kind::Byte(0, 1), 1), (Kind::Byte(0, 1), 1), (Kind::Byte(0, 1), 1),
    (Kind::Byte(0, 1), 1), (Kind::Byte(0, 1), 1), (Kind::Byte(0, 1), 1), (Kind::Byte(0, 1), 1),
    (Kind::Word(1, 900), 60),       // 0x0E period of logging: charger
    (Kind::Word(1, 900), 30),       // 0x0F MPPT
    (Kind::Word(1, 900), 30),       // 0x10 battery monitor
    (Kind::Word(1, 900), 60),       // 0x11 inverters
    (Kind::Word(1, 900), 120),      // 0x12 tracker
    (Kind::Word(15, 7200), 60),     // 0x13 generator: delay before the start
    (Kind::Word(15, 7200), 120),    // 0x14 before the stop
    (Kind::Word(1, 6), 4),          // 0x15 before the check whether it runs
    (Kind::Word(1, 15), 5),         // 0x16 wait before a start
    (Kind::Byte(1, 8), 3),          // 0x17 attempts
    (Kind::Starts, 0),              // 0x18
    (Kind::Word(5, 18_000), 7200),  // 0x19 run
    (Kind::Word(1800, 7200), 1800), // 0x1A rest
    (Kind::Word(60, 300), 120),     // 0x1B test
    (Kind::Byte(0, 1), 1),          // 0x1C it starts by itself
    (Kind::Date, 0),                // 0x1D last run
    (Kind::Byte(0, 18), 3),         // 0x1E time zone, h
    (Kind::Degrees(90.0), 0), (Kind::Degrees(180.0), 0),
    (Kind::Word(0, 32_767), 78),    // 0x21 elevation, m
    (Kind::Word(0, 5000), 752),     // 0x22 pressure, mmHg
    (Kind::Byte(0, 255), 15),       // 0x23 temperature, °C
    (Kind::Word(0, 360), 0),        // 0x24 slope of the panels, degrees
    (Kind::Word(0, 360), 180),      // 0x25 turn of the panels, degrees
    (Kind::Byte(3, 10), 5),         // 0x26 charging ends at this current, A
    (Kind::Word(15, 7200), 30),     // 0x27 inverters: delay before switching on
    (Kind::Word(15, 7200), 60),     // 0x28 before switching off
];

/// What is set.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    texts: [[u8; 16]; 3],
    /// By PARAM_ID; unused where a setting is no number.
    numbers: [u16; COUNT as usize],
    last_charge: [u8; 4],
    last_run: [u8; 4],
    starts: [u8; 8],
    latitude: f64,
    longitude: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            texts: ["station.scr", "spring_job.txt", "test_job.txt"].map(text),
            numbers: PARAMETERS.map(|(_, value)| value),
            last_charge: [12, 4, 0xE8, 0x07],
            last_run: [9, 4, 0xE8, 0x07],
            starts: [2, 3, 3, 4, 4, 5, 5, 6],
            latitude: SITE.latitude,
            longitude: SITE.longitude,
        }
    }
}

impl Settings {
    /// The number set for `parameter`; 0 where the setting is no number.
    pub fn number(&self, parameter: u8) -> u16 {
        self.numbers.get(usize::from(parameter)).copied().unwrap_or_default()
    }

    /// CONFIG_1 to CONFIG_15 (section 4.3), in order.
    pub fn read_out(&self) -> Vec<CanFrame> {
        let halves = self.texts.iter().flat_map(|text| text.chunks(8)).map(<[u8]>::to_vec);
        let packets = halves.chain(self.numbers());
        (1..).zip(packets).map(|(number, data)| frame(device::CONFIG, 0, number, &data)).collect()
    }

    /// The data of CONFIG_7 to CONFIG_15.
    fn numbers(&self) -> [Vec<u8>; 9] {
        let bytes = |ids: &[u8]| -> Vec<u8> {
            ids.iter().flat_map(|id| self.number(*id).to_le_bytes()).collect()
        };
        let low = |id: u8| self.number(id).to_le_bytes()[0];
        let bits = |ids: &[u8], from: u8| {
            (from..).zip(ids).fold(0, |byte, (bit, id)| byte | (low(*id) & 1) << bit)
        };
        let flags = [
            low(0x03) & 0xF | bits(&[0x06, 0x07, 0x08, 0x09], 4),
            bits(&[0x0A, 0x0B, 0x0C, 0x0D, 0x04, 0x1C], 0),
            low(0x26),
        ];
        [
            [&flags[..], &bytes(&[0x27, 0x28])].concat(),
            [&self.last_charge[..], &bytes(&[0x0E, 0x0F])].concat(),
            bytes(&[0x10, 0x11, 0x12, 0x19]),
            [
                &bytes(&[0x13, 0x14])[..],
                // Attempts and the check of the run share a byte; then the wait before a start.
                &[low(0x17) & 0xF | low(0x15) << 4, low(0x16)],
                &bytes(&[0x1A]),
            ]
            .concat(),
            self.starts.to_vec(),
            [&bytes(&[0x1B])[..], &self.last_run, &[low(0x1E), low(0x23)]].concat(),
            bytes(&[0x21, 0x22, 0x24, 0x25]),
            self.latitude.to_le_bytes().to_vec(),
            self.longitude.to_le_bytes().to_vec(),
        ]
    }

    /// Takes what the HMI sent for `parameter`; `packet` is 1 for the second half of a text.
    /// Values of the wrong size or outside of what is accepted change nothing.
    pub fn store(&mut self, parameter: u8, packet: u8, data: &[u8]) {
        let index = usize::from(parameter);
        let Some((kind, _)) = PARAMETERS.get(index) else { return };
        let number = match (kind, data) {
            (Kind::Byte(..), [value]) => Some(u16::from(*value)),
            (Kind::Word(..), [low, high]) => Some(u16::from_le_bytes([*low, *high])),
            _ => None,
        };
        match (*kind, number) {
            (Kind::Byte(least, most) | Kind::Word(least, most), Some(number))
                if (least..=most).contains(&number) =>
            {
                self.numbers[index] = number;
            }
            (Kind::Text, _) => self.store_half(index, packet, data),
            (Kind::Date, _) => {
                let date =
                    if parameter == 0x05 { &mut self.last_charge } else { &mut self.last_run };
                *date = data.try_into().unwrap_or(*date);
            }
            (Kind::Starts, _) if data.iter().all(|seconds| (1..=6).contains(seconds)) => {
                self.starts = data.try_into().unwrap_or(self.starts);
            }
            (Kind::Degrees(most), _) => {
                let angle = data.try_into().map_or(f64::NAN, f64::from_le_bytes);
                let place =
                    if parameter == 0x1F { &mut self.latitude } else { &mut self.longitude };
                *place = if (0.0..=most).contains(&angle) { angle } else { *place };
            }
            _ => {}
        }
    }

    fn store_half(&mut self, index: usize, packet: u8, data: &[u8]) {
        let from = usize::from(packet & 1) * 8;
        let half = self.texts.get_mut(index).and_then(|text| text.get_mut(from..from + 8));
        if let (Some(half), 8) = (half, data.len()) {
            half.copy_from_slice(data);
        }
    }

    /// What a person would send to change `parameter` a little: one frame, two for a text.
    /// `today` is a date as it is sent.
    pub fn change(&self, parameter: u8, today: [u8; 4], random: &mut Random) -> Vec<CanFrame> {
        let Some((kind, usual)) = PARAMETERS.get(usize::from(parameter)) else { return Vec::new() };
        let set = |data: &[u8]| vec![frame(device::CONFIG, parameter, 0, data)];
        match *kind {
            Kind::Text => {
                let names = ["spring_job.txt", "summer_job.txt", "station.scr"];
                let bytes = text(names[random.index(3)]);
                let halves = (0..).zip(bytes.chunks(8));
                halves.map(|(half, data)| frame(device::CONFIG, parameter, half, data)).collect()
            }
            Kind::Byte(least, most) if most - least <= 2 => {
                set(&[random.index(usize::from(most - least) + 1) as u8 + least as u8])
            }
            Kind::Byte(least, most) => set(&near(*usual, least, most, random).to_le_bytes()[..1]),
            Kind::Word(least, most) => set(&near(*usual, least, most, random).to_le_bytes()),
            Kind::Date => set(&today),
            Kind::Starts => set(&self.starts.map(|_| 2 + random.index(4) as u8)),
            // The station stays where it is.
            Kind::Degrees(most) if most > 90.0 => set(&self.longitude.to_le_bytes()),
            Kind::Degrees(_) => set(&self.latitude.to_le_bytes()),
        }
    }
}

/// A value not far from the usual one.
fn near(usual: u16, least: u16, most: u16, random: &mut Random) -> u16 {
    let value = (f64::from(usual) * random.between(0.75, 1.35)).round() as u16;
    value.clamp(least, most)
}

/// The HMI's request of all settings: a remote frame (section 5.3).
pub fn request() -> CanFrame {
    CanFrame::new(u32::from(device::CONFIG) << 16, CanFlags::EXTENDED | CanFlags::REMOTE, &[])
}

/// The HMI's order to keep the settings in the EEPROM (section 5.5).
pub fn save() -> CanFrame {
    frame(device::CONFIG, 0, 0xFF, &[])
}

/// A string of at most 15 characters in 16 bytes, filled up with NUL (section 7).
fn text(value: &str) -> [u8; 16] {
    let mut bytes = [0; 16];
    for (to, from) in bytes.iter_mut().take(15).zip(value.bytes()) {
        *to = from;
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fifteen_packets_of_the_documented_sizes_answer_the_request() {
        let packets = Settings::default().read_out();
        let ids: Vec<u32> = packets.iter().map(|p| p.id).collect();
        assert_eq!(ids, (0x0013_0001..=0x0013_000F).collect::<Vec<u32>>());
        let sizes: Vec<usize> = packets.iter().map(|p| p.data().len()).collect();
        assert_eq!(sizes, [8, 8, 8, 8, 8, 8, 7, 8, 8, 8, 8, 8, 8, 8, 8]);
    }

    #[test]
    fn numbers_stand_where_the_sample_vectors_have_them() {
        // CONFIG_7 of the samples: b0 bf 3b 7a be 2e 88 = mode 0, stop at 59 A, delays 48762, 34862.
        let mut settings = Settings::default();
        for (parameter, value) in [
            (0x03, 0),
            (0x26, 59),
            (0x27, 48_762),
            (0x28, 34_862),
            (0x13, 37_399),
            (0x14, 31_086),
            (0x17, 13),
            (0x1A, 28_728),
        ] {
            settings.numbers[parameter] = value;
        }
        let packets = settings.read_out();
        assert_eq!(packets[6].data()[2..], [0x3b, 0x7a, 0xbe, 0x2e, 0x88]);
        assert_eq!(packets[6].data()[0] & 0xF, 0);
        // CONFIG_10 of the samples: 17 92 6e 79 0d 64 38 70, other waits here.
        assert_eq!(packets[9].data(), [0x17, 0x92, 0x6e, 0x79, 0x4d, 5, 0x38, 0x70]);
        assert_eq!(packets[13].data(), 47.235_7_f64.to_le_bytes());
    }

    #[test]
    fn a_file_name_has_two_halves_and_ends_with_nul() {
        let mut settings = Settings::default();
        settings.store(1, 0, b"summer_j");
        settings.store(1, 1, b"obs.txt\0");
        assert_eq!(settings.texts[1], *b"summer_jobs.txt\0");
        settings.store(1, 1, b"short");
        assert_eq!(settings.texts[1], *b"summer_jobs.txt\0");
        assert_eq!(text("much_too_long_a_name.txt")[15], 0);
    }

    #[test]
    fn what_is_accepted_is_stored_and_nothing_else() {
        let mut settings = Settings::default();
        settings.store(0x27, 0, &[45, 0]);
        assert_eq!(settings.number(0x27), 45);
        for refused in [&[14, 0][..], &[0xFF, 0xFF], &[45], &[]] {
            settings.store(0x27, 0, refused);
            assert_eq!(settings.number(0x27), 45, "{refused:?}");
        }
        settings.store(0x29, 0, &[1]);
        let before = settings.clone();
        settings.store(0x1F, 0, &f64::NAN.to_le_bytes());
        settings.store(0x18, 0, &[7; 8]);
        assert_eq!(settings, before);
    }

    #[test]
    fn every_change_a_person_makes_is_accepted_and_read_back() {
        let mut random = Random::new(5, 5);
        for parameter in (0..COUNT).cycle().take(400) {
            let (before, mut after) = (Settings::default(), Settings::default());
            for sent in before.change(parameter, [1, 2, 0xE8, 7], &mut random) {
                let [packet, id, ..] = sent.id.to_le_bytes();
                assert_eq!(id, parameter);
                after.store(id, packet, sent.data());
                let (kind, _) = PARAMETERS[usize::from(parameter)];
                if matches!(kind, Kind::Byte(..) | Kind::Word(..)) {
                    let number = sent.data().iter().rev().fold(0, |n, b| n << 8 | u16::from(*b));
                    assert_eq!(after.number(parameter), number, "{parameter:#x}");
                }
            }
        }
    }

    #[test]
    fn the_request_is_the_only_remote_frame() {
        let request = request();
        assert_eq!(request.id, 0x0013_0000);
        assert!(request.flags.has(CanFlags::REMOTE) && request.data().is_empty());
        assert_eq!(save().id, 0x0013_00FF);
    }
}
