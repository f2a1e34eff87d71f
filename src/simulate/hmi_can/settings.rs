//! The controller's settings: read out as fifteen packets, written one by one.

use super::{device, frame};
use crate::frame::{CanFlags, CanFrame};
use crate::simulate::station::SITE;

/// What can be set (HMI CAN protocol, sections 4.3 and 5.4). Times in seconds.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the names are the document's")]
pub struct Settings {
    /// At most 15 characters each.
    pub scr_file: String,
    pub job_file: String,
    pub job_test: String,
    /// 0 test, 1 backup, 2 mixed.
    pub mode_sys: u8,
    pub pb_current_stop: u8,
    pub delay_start_ts: u16,
    pub delay_stop_ts: u16,
    /// Period of logging: charger, MPPT, battery monitor, inverters, tracker.
    pub datlog_upd: [u16; 5],
    pub gen_time_run: u16,
    pub gen_delay_start: u16,
    pub gen_delay_stop: u16,
    pub gen_cnt_start: u8,
    pub gen_time_sleep: u16,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            scr_file: "station.scr".into(),
            job_file: "spring_job.txt".into(),
            job_test: "test_job.txt".into(),
            mode_sys: 2,
            pb_current_stop: 5,
            delay_start_ts: 30,
            delay_stop_ts: 60,
            datlog_upd: [60, 30, 30, 60, 120],
            gen_time_run: 7200,
            gen_delay_start: 60,
            gen_delay_stop: 120,
            gen_cnt_start: 3,
            gen_time_sleep: 1800,
        }
    }
}

/// A date as it is sent: day, month, year low byte first.
const LAST_CHARGE: [u8; 4] = [12, 4, 0xE8, 0x07];
const LAST_RUN: [u8; 6] = [9, 4, 0xE8, 0x07, 3, 15];

impl Settings {
    /// CONFIG_1 to CONFIG_15 (section 4.3), in order.
    pub fn read_out(&self) -> Vec<CanFrame> {
        let files = [&self.scr_file, &self.job_file, &self.job_test].map(|file| text(file));
        let halves = files.iter().flat_map(|file| file.chunks(8)).map(<[u8]>::to_vec);
        let packets = halves.chain(self.numbers());
        (1..).zip(packets).map(|(number, data)| frame(device::CONFIG, 0, number, &data)).collect()
    }

    /// The data of CONFIG_7 to CONFIG_15.
    fn numbers(&self) -> [Vec<u8>; 9] {
        let words = |words: &[u16]| words.iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<u8>>();
        // Everything is logged, into one directory a month; the generator starts by itself.
        let flags = [self.mode_sys & 0xF | 0xF0, 0b0011_1111, self.pb_current_stop];
        let [charger, mppt, monitor, inverters, tracker] = self.datlog_upd;
        let test = words(&[120]);
        [
            [&flags[..], &words(&[self.delay_start_ts, self.delay_stop_ts])].concat(),
            [&LAST_CHARGE[..], &words(&[charger, mppt])].concat(),
            words(&[monitor, inverters, tracker, self.gen_time_run]),
            [
                words(&[self.gen_delay_start, self.gen_delay_stop]),
                // Attempts and the check of the run share a byte; then the wait before a start.
                vec![self.gen_cnt_start & 0xF | 4 << 4, 5],
                words(&[self.gen_time_sleep]),
            ]
            .concat(),
            // Starter time of each attempt.
            vec![2, 3, 3, 4, 4, 5, 5, 6],
            [&test[..], &LAST_RUN].concat(),
            // Elevation, pressure, slope and turn of the panels.
            words(&[78, 752, 0, 180]),
            SITE.latitude.to_le_bytes().to_vec(),
            SITE.longitude.to_le_bytes().to_vec(),
        ]
    }
}

/// The HMI's request of all settings: a remote frame (section 5.3).
pub fn request() -> CanFrame {
    CanFrame::new(u32::from(device::CONFIG) << 16, CanFlags::EXTENDED | CanFlags::REMOTE, &[])
}

/// The HMI's order to keep the settings in the EEPROM (section 5.5).
pub fn save() -> CanFrame {
    frame(device::CONFIG, 0, 0xFF, &[])
}

/// The HMI sets a number: `data` as section 5.4 says for `parameter`.
pub fn set(parameter: u8, data: &[u8]) -> CanFrame {
    frame(device::CONFIG, parameter, 0, data)
}

/// The HMI sets a file name (parameter 0 to 2): two halves.
pub fn set_text(parameter: u8, value: &str) -> [CanFrame; 2] {
    let bytes = text(value);
    [0, 1].map(|half| {
        let from = usize::from(half) * 8;
        frame(device::CONFIG, parameter, half, &bytes[from..from + 8])
    })
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
        let settings = Settings {
            mode_sys: 0,
            pb_current_stop: 59,
            delay_start_ts: 48_762,
            delay_stop_ts: 34_862,
            gen_delay_start: 37_399,
            gen_delay_stop: 31_086,
            gen_cnt_start: 13,
            gen_time_sleep: 28_728,
            ..Settings::default()
        };
        let packets = settings.read_out();
        assert_eq!(packets[6].data()[2..], [0x3b, 0x7a, 0xbe, 0x2e, 0x88]);
        assert_eq!(packets[6].data()[0] & 0xF, 0);
        // CONFIG_10 of the samples: 17 92 6e 79 0d 64 38 70, other waits here.
        assert_eq!(packets[9].data(), [0x17, 0x92, 0x6e, 0x79, 0x4d, 5, 0x38, 0x70]);
        assert_eq!(packets[13].data(), 47.235_7_f64.to_le_bytes());
    }

    #[test]
    fn a_file_name_is_written_as_in_the_sample_vectors() {
        let [first, second] = set_text(1, "summer_jobs.txt");
        assert_eq!((first.id, first.data()), (0x0013_0100, &b"summer_j"[..]));
        assert_eq!((second.id, second.data()), (0x0013_0101, &b"obs.txt\0"[..]));
        assert_eq!(text("much_too_long_a_name.txt")[15], 0);
    }

    #[test]
    fn the_request_is_the_only_remote_frame() {
        let request = request();
        assert_eq!(request.id, 0x0013_0000);
        assert!(request.flags.has(CanFlags::REMOTE) && request.data().is_empty());
        assert_eq!(save().id, 0x0013_00FF);
    }
}
