//! Buses as numbers, for formats that have no names.

use std::collections::BTreeSet;

use super::super::BusHead;

/// The buses of a log: a number from 1 up for each, and its name.
///
/// The number is the name where that is one, one more than the number at its end otherwise (`can0`
/// is channel 1, as in other converters), and the lowest free one where that is taken or there is
/// none. All are different.
pub struct Channels(Vec<(u16, String)>);

impl Channels {
    /// Those that are known at the start: names that are numbers come first.
    pub fn of(buses: &[BusHead]) -> Self {
        let mut taken = BTreeSet::new();
        let mut given: Vec<Option<u16>> = vec![None; buses.len()];
        for wish in [own_number, number_at_end] {
            for (bus, number) in buses.iter().zip(&mut given) {
                if number.is_none() {
                    *number = wish(&bus.name).filter(|wish| taken.insert(*wish));
                }
            }
        }
        let mut free = (1..=u16::MAX).filter(|number| !taken.contains(number));
        // More than 65535 buses do not exist; they would share the last number.
        let numbers = given.into_iter().map(|n| n.or_else(|| free.next()).unwrap_or(u16::MAX));
        Self(numbers.zip(buses.iter().map(|bus| bus.name.clone())).collect())
    }

    /// One more: it has the number that its name wishes if nobody has it.
    pub fn add(&mut self, bus: &BusHead) {
        let wishes = [own_number(&bus.name), number_at_end(&bus.name)].into_iter().flatten();
        let mut wishes = wishes.chain(1..=u16::MAX);
        let free = |number: &u16| self.0.iter().all(|(taken, _)| taken != number);
        let number = wishes.find(free).unwrap_or(u16::MAX);
        self.0.push((number, bus.name.clone()));
    }

    /// The number of the bus with this index.
    pub fn number(&self, bus: u16) -> Option<u16> {
        self.0.get(usize::from(bus)).map(|(number, _)| *number)
    }

    /// Its name.
    pub fn name(&self, bus: u16) -> &str {
        self.0.get(usize::from(bus)).map_or("", |(_, name)| name)
    }

    /// Numbers and names, in the order of the buses.
    pub fn list(&self) -> &[(u16, String)] {
        &self.0
    }
}

/// One byte holds a channel in some objects.
const MOST: u16 = 255;

fn own_number(name: &str) -> Option<u16> {
    name.parse().ok().filter(|number| (1..=MOST).contains(number))
}

fn number_at_end(name: &str) -> Option<u16> {
    let digits = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let number: u16 = name[digits..].parse().ok()?;
    number.checked_add(1).filter(|number| (1..=MOST).contains(number))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str]) -> Vec<u16> {
        let head = |name: &&str| BusHead { name: (*name).into(), bitrate: None };
        let channels = Channels::of(&names.iter().map(head).collect::<Vec<_>>());
        channels.list().iter().map(|(number, _)| *number).collect()
    }

    #[test]
    fn numbers_keep_what_names_say_and_are_all_different() {
        assert_eq!(of(&["can0", "can1"]), [1, 2]);
        assert_eq!(of(&["can3", "2", "vcan3", "body"]), [4, 2, 1, 3]);
        assert_eq!(of(&["1", "can0", "0", "65536"]), [1, 2, 3, 4]);
    }
}
