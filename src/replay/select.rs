//! Which frames of a bus are played, and under which identifier.

use std::sync::Arc;

use super::tally::NotSent;
use crate::capture::socketcan::CanSettings;
use crate::decode::definition::CanDefinition;
use crate::frame::{CanFlags, CanFrame, Direction, Frame};

/// Frames by their place in the frame: an identifier, or a decoded message's name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Which {
    /// This identifier.
    Id {
        /// 11 or 29 bits.
        id: u32,
        /// 29-bit.
        extended: bool,
    },
    /// The message of this name.
    Message(String),
}

impl Which {
    /// Reads an identifier, hexadecimal as candump writes it (8 digits: 29 bits), else a name.
    pub fn parse(text: &str) -> Self {
        match identifier(text) {
            Some((id, extended)) => Self::Id { id, extended },
            None => Self::Message(text.to_owned()),
        }
    }
}

/// `123` or `00000123`: an identifier and whether it is a 29-bit one.
pub fn identifier(text: &str) -> Option<(u32, bool)> {
    let extended = text.len() == 8;
    let id = u32::from_str_radix(text, 16).ok()?;
    let largest = if extended { 0x1FFF_FFFF } else { 0x7FF };
    ((extended || text.len() == 3) && id <= largest).then_some((id, extended))
}

/// What is played of one bus.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// candump filters.
    pub filters: CanSettings,
    /// Only messages of these names, if there are any.
    pub messages: Vec<String>,
    /// What messages are told by.
    pub definition: Option<Arc<CanDefinition>>,
    /// Only what went this way.
    pub only: Option<Direction>,
    /// Frames that get another identifier, and whether that has 29 bits.
    pub remap: Vec<(Which, u32, bool)>,
    /// Error frames go along (as text; they are never sent).
    pub error_frames: bool,
}

impl Selection {
    /// Judges a frame and gives it its new identifier.
    ///
    /// # Errors
    /// Why it is not sent.
    pub fn take(&self, frame: &mut Frame) -> Result<(), NotSent> {
        match frame {
            Frame::Can(frame) => self.take_can(frame),
            Frame::Serial(bytes) if self.only.is_some_and(|only| only != bytes.direction) => {
                Err(NotSent::OtherDirection)
            }
            Frame::Serial(_) | Frame::Gap(_) | Frame::Notice(_) => Ok(()),
        }
    }

    fn take_can(&self, frame: &mut CanFrame) -> Result<(), NotSent> {
        let error = frame.flags.has(CanFlags::ERROR);
        if error && !self.error_frames {
            return Err(NotSent::ErrorFrame);
        }
        let sent = frame.flags.has(CanFlags::TX);
        if self.only.is_some_and(|only| (only == Direction::Tx) != sent) {
            return Err(NotSent::OtherDirection);
        }
        if !self.filters.passes(frame) {
            return Err(NotSent::Filtered);
        }
        if self.messages.is_empty() && self.remap.is_empty() || error {
            return Ok(());
        }
        let name = self.definition.as_ref().and_then(|definition| definition.name_of(frame));
        if !self.messages.is_empty() && !self.messages.iter().any(|m| Some(m.as_str()) == name) {
            return Err(NotSent::Filtered);
        }
        let extended = frame.flags.has(CanFlags::EXTENDED);
        let fits = |which: &Which| match which {
            Which::Id { id, extended: long } => *id == frame.id && *long == extended,
            Which::Message(wanted) => Some(wanted.as_str()) == name,
        };
        if let Some(&(_, id, long)) = self.remap.iter().find(|(which, ..)| fits(which)) {
            frame.id = id;
            let others = frame.flags.0 & !CanFlags::EXTENDED.0;
            frame.flags = CanFlags(others | if long { CanFlags::EXTENDED.0 } else { 0 });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::SerialBytes;

    fn can(id: u32, flags: CanFlags) -> Frame {
        Frame::Can(CanFrame::new(id, flags, &[1]))
    }

    #[test]
    fn frames_are_judged_by_kind_direction_and_identifier() {
        let none = CanFlags::default();
        let all = Selection::default();
        assert_eq!(all.take(&mut can(0x123, none)), Ok(()));
        assert_eq!(all.take(&mut can(4, CanFlags::ERROR)), Err(NotSent::ErrorFrame));
        let rx = Selection { only: Some(Direction::Rx), ..Selection::default() };
        assert_eq!(rx.take(&mut can(0x123, none)), Ok(()));
        assert_eq!(rx.take(&mut can(0x123, CanFlags::TX)), Err(NotSent::OtherDirection));
        let bytes = SerialBytes { direction: Direction::Tx, data: vec![1], errors: Vec::new() };
        assert_eq!(rx.take(&mut Frame::Serial(bytes)), Err(NotSent::OtherDirection));
        let filters = "x,123:7FF".parse().unwrap();
        let one = Selection { filters, ..Selection::default() };
        assert_eq!(one.take(&mut can(0x124, none)), Err(NotSent::Filtered));
    }

    #[test]
    fn an_identifier_is_replaced_by_another_of_either_length() {
        let remap = vec![(Which::parse("123"), 0x1234_5678, true)];
        let selection = Selection { remap, ..Selection::default() };
        let mut frame = can(0x123, CanFlags::TX);
        selection.take(&mut frame).unwrap();
        assert_eq!(frame, can(0x1234_5678, CanFlags::EXTENDED | CanFlags::TX));
        let mut other = can(0x123, CanFlags::EXTENDED);
        selection.take(&mut other).unwrap();
        assert_eq!(other, can(0x123, CanFlags::EXTENDED));
    }

    #[test]
    fn identifiers_are_told_from_names_by_their_digits() {
        assert_eq!(identifier("7FF"), Some((0x7FF, false)));
        assert_eq!(identifier("00000123"), Some((0x123, true)));
        for text in ["800", "20000000", "12", "CONFIG_1", "1234"] {
            assert_eq!(identifier(text), None, "{text}");
        }
    }
}
