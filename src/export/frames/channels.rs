//! Buses as numbers, for formats that have no names.

use std::collections::BTreeSet;

use super::super::BusHead;

/// A number from 1 up for each bus: its name where that is a number, one more than the number at its
/// end otherwise (`can0` is channel 1, as in other converters), and the lowest free one where that
/// is taken or there is none. All are different.
pub fn numbers(buses: &[BusHead]) -> Vec<u16> {
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
    given.into_iter().map(|n| n.or_else(|| free.next()).unwrap_or(u16::MAX)).collect()
}

/// The number of one more bus: as its name wishes if nobody has it, else the lowest free one.
pub fn add(given: &mut Vec<u16>, bus: &BusHead) {
    let wishes = [own_number(&bus.name), number_at_end(&bus.name)].into_iter().flatten();
    let mut wishes = wishes.chain(1..=u16::MAX);
    let number = wishes.find(|number| !given.contains(number)).unwrap_or(u16::MAX);
    given.push(number);
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
        let head = |name: &&str| BusHead { name: (*name).into(), serial: false, bitrate: None };
        numbers(&names.iter().map(head).collect::<Vec<_>>())
    }

    #[test]
    fn numbers_keep_what_names_say_and_are_all_different() {
        assert_eq!(of(&["can0", "can1"]), [1, 2]);
        assert_eq!(of(&["can3", "2", "vcan3", "body"]), [4, 2, 1, 3]);
        assert_eq!(of(&["1", "can0", "0", "65536"]), [1, 2, 3, 4]);
    }
}
