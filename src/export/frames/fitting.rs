//! Names of buses in formats where they stand between blanks or commas.
//!
//! A log may call a bus anything (`Powertrain CAN`, or a text with the end of a line in it). Written as
//! it is, its lines would be others than they should be.

use std::borrow::Cow;

use super::super::BusHead;
use super::kept::{NAMES, Unkept};
use crate::decode::dbc::names::Names;

/// The names that the buses of an output have.
pub struct Fitting {
    /// By bus; true where it is not the bus's own.
    names: Vec<(String, bool)>,
    taken: Names,
}

impl Fitting {
    /// Those that are known at the start: names that can stay as they are do.
    pub fn of(buses: &[BusHead]) -> Self {
        let mut all =
            Self { names: vec![(String::new(), false); buses.len()], taken: Names::default() };
        for own in [true, false] {
            for (index, bus) in buses.iter().enumerate() {
                if (fitting(&bus.name) == bus.name) == own {
                    all.names[index] = all.name(bus);
                }
            }
        }
        all
    }

    /// One more.
    pub fn add(&mut self, bus: &BusHead) {
        let name = self.name(bus);
        self.names.push(name);
    }

    fn name(&mut self, bus: &BusHead) -> (String, bool) {
        let name = self.taken.take(&fitting(&bus.name));
        let changed = name != bus.name;
        (name, changed)
    }

    /// The name of a bus; counted where it is not its own.
    pub fn get(&self, bus: u16, unkept: &mut Unkept) -> Option<&str> {
        let (name, changed) = self.names.get(usize::from(bus))?;
        if *changed {
            unkept.add(NAMES);
        }
        Some(name)
    }
}

/// Letters and digits stay, also those of other languages. What else there is becomes `_`, as does a
/// dash in front, which a spreadsheet would take for a formula.
fn fitting(name: &str) -> Cow<'_, str> {
    let fits =
        |(at, c): (usize, char)| c.is_alphanumeric() || "_.".contains(c) || c == '-' && at > 0;
    if !name.is_empty() && name.char_indices().all(fits) {
        return name.into();
    }
    let fitting: String =
        name.char_indices().map(|place| if fits(place) { place.1 } else { '_' }).collect();
    if fitting.is_empty() { "_".into() } else { fitting.into() }
}

/// A name in a comment, which a line's end must not end.
pub fn in_one_line(name: &str) -> String {
    let ends = |c: char| c.is_control() || matches!(c, '\u{2028}' | '\u{2029}');
    name.chars().map(|c| if ends(c) { '_' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_or_become_others_that_nobody_has() {
        let head = |name: &&str| BusHead { name: (*name).into(), bitrate: None };
        let names =
            ["Powertrain CAN", "Powertrain_CAN", "", "b\nus", "-1", "größe-2.x", "Powertrain\tCAN"];
        let fitting = Fitting::of(&names.iter().map(head).collect::<Vec<_>>());
        let found: Vec<&str> = fitting.names.iter().map(|(name, _)| name.as_str()).collect();
        let wanted = [
            "Powertrain_CAN_2",
            "Powertrain_CAN",
            "_",
            "b_us",
            "_1",
            "größe-2.x",
            "Powertrain_CAN_3",
        ];
        assert_eq!(found, wanted);
        let changed: Vec<bool> = fitting.names.iter().map(|(_, changed)| *changed).collect();
        assert_eq!(changed, [true, false, true, true, true, false, true]);
    }
}
