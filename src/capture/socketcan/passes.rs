//! The kernel's filters, applied to frames that are already recorded.

use super::settings::{CanFilter, CanSettings};
use crate::frame::{CanFlags, CanFrame};

/// `CAN_EFF_FLAG`, `CAN_RTR_FLAG` and `CAN_INV_FILTER` of `linux/can.h` and `linux/can/raw.h`.
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const INVERTED: u32 = 0x2000_0000;

impl CanSettings {
    /// True if the kernel would have let this frame pass: as `can_rcv_filter` of `net/can/af_can.c`
    /// has it.
    pub fn passes(&self, frame: &CanFrame) -> bool {
        if frame.flags.has(CanFlags::ERROR) {
            return frame.id & self.error_mask.unwrap_or(u32::MAX) != 0;
        }
        let matches = |filter: &CanFilter| filter.matches(frame);
        match (&self.filters[..], self.join) {
            ([], _) => true,
            (filters, true) => filters.iter().all(matches),
            (filters, false) => filters.iter().any(matches),
        }
    }
}

impl CanFilter {
    fn matches(&self, frame: &CanFrame) -> bool {
        let flag = |flag, bit| if frame.flags.has(flag) { bit } else { 0 };
        let id = frame.id | flag(CanFlags::EXTENDED, EXTENDED) | flag(CanFlags::REMOTE, REMOTE);
        let same = id & self.mask == self.id & !INVERTED & self.mask;
        same != (self.id & INVERTED != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passes(filters: &str, id: u32, flags: CanFlags) -> bool {
        let settings: CanSettings = format!("can0,{filters}").parse().unwrap();
        settings.passes(&CanFrame::new(id, flags, &[]))
    }

    #[test]
    fn recorded_frames_pass_as_in_the_kernel() {
        let plain = CanFlags::default();
        assert!(passes("123:7FF", 0x123, plain));
        assert!(!passes("123:7FF", 0x124, plain));
        assert!(!passes("~123:7FF", 0x123, plain));
        assert!(passes("123:7FF,124:7FF", 0x124, plain));
        assert!(!passes("100:700,~123:7FF,j", 0x123, plain));
        assert!(passes("100:700,~123:7FF,j", 0x122, plain));
        assert!(passes("12345678:DFFFFFFF", 0x1234_5678, CanFlags::EXTENDED));
        assert!(!passes("123:C00007FF", 0x123, CanFlags::REMOTE));
        assert!(!passes("#1", 2, CanFlags::ERROR));
        assert!(passes("#FFFFFFFF", 2, CanFlags::ERROR));
    }
}
