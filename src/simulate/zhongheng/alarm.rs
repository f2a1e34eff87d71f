//! The 80 alarms of the monitor (Zhongheng 09-series RS232 protocol, section 8, 0x414b).

/// Number of alarms.
pub const COUNT: usize = 80;

/// No alarm.
const NONE: u8 = 5;
/// The alarm is disabled.
const DISABLED: u8 = 0;

/// Alarms this simulation can raise, as numbered by the document.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the document's")]
pub enum Alarm {
    LowFloat = 0,
    RectifierFail = 4,
    AcFail = 9,
    BatteryTemperatureHigh = 29,
    Equalize = 30,
    InDischarge = 36,
    BatteryCurrentLimit = 38,
    AcHigh = 46,
    AcLow = 47,
    DigitalInput1 = 53,
}

/// Level of alarm `index`: 1 critical, 2 major, 3 minor, 4 warning; 0 for those without a name in
/// the document, which are disabled.
pub fn level(index: usize) -> u8 {
    match index {
        18 | 19 | 22 | 23 | 31 | 43 | 44 | 50 | 51 | 71.. => DISABLED,
        0 | 9 | 11 | 12 | 16 | 20 | 48 => 1,
        2..=5 | 10 | 13 | 14 | 28 | 29 | 36 | 37 | 42 => 2,
        30 | 32 | 38 | 40 | 41 | 66 => 4,
        _ => 3,
    }
}

/// Which alarms are up, and what the event log knows of them.
#[derive(Clone, Debug)]
pub struct Alarms {
    up: [bool; COUNT],
    /// Something came up that the master has not read yet.
    news: bool,
    /// Index of the last entry in the event log.
    last: u32,
}

impl Default for Alarms {
    fn default() -> Self {
        Self { up: [false; COUNT], news: false, last: 1_482 }
    }
}

impl Alarms {
    /// `alarm` is up, or not.
    pub fn set(&mut self, alarm: Alarm, up: bool) {
        let slot = &mut self.up[alarm as usize];
        if *slot != up {
            *slot = up;
            self.news |= up;
            self.last += 1;
        }
    }

    /// The code 0x414b shows for alarm `index`: its level while it is up, 5 while it is not, 0
    /// when it is disabled.
    pub fn code(&self, index: usize) -> u8 {
        match (level(index), self.up.get(index)) {
            (DISABLED, _) => DISABLED,
            (level, Some(true)) => level,
            _ => NONE,
        }
    }

    /// True while any alarm is up.
    pub fn any(&self) -> bool {
        self.up.contains(&true)
    }

    /// True while `alarm` is up.
    pub fn is_up(&self, alarm: Alarm) -> bool {
        self.up[alarm as usize]
    }

    /// True until the master has read what is up: the status bit of every answer (section 5.2).
    pub fn news(&self) -> bool {
        self.news
    }

    /// The master has read what is up.
    pub fn read(&mut self) {
        self.news = false;
    }

    /// First and last index in the event log, which holds 500 entries.
    pub fn log(&self) -> (u32, u32) {
        (self.last.saturating_sub(499), self.last)
    }
}
