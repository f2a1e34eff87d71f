//! The language of conditions.

use std::fmt;

use crate::frame::error;
use crate::text::parse_duration;

/// Something that can happen, perhaps on one bus only.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// The bus; any if there is none.
    pub bus: Option<String>,
    /// What happens.
    pub what: What,
}

/// What happens.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// `gap`: something was lost.
    Gap,
    /// `mark`: somebody has set a mark.
    Mark,
    /// `error frame`, `error frame CLASS`, `bus-off`, `error-passive`, `error-warning`: a CAN error
    /// frame, of this class or about this.
    ErrorFrame(Option<String>),
    /// `no MESSAGE for TIME`, or `no frames for TIME`.
    Silence {
        /// `None` for frames of any kind.
        message: Option<String>,
        /// How long, nanoseconds.
        nanos: u64,
    },
    /// `MESSAGE`: it was received.
    Message(String),
    /// `MESSAGE.SIGNAL < NUMBER`: its physical value.
    Signal {
        /// The message.
        message: String,
        /// The signal.
        signal: String,
        /// How to compare.
        comparison: Comparison,
        /// With what; finite.
        value: f64,
    },
}

/// How values are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// `<`
    Less,
    /// `<=`
    AtMost,
    /// `>`
    Greater,
    /// `>=`
    AtLeast,
    /// `==`
    Equal,
    /// `!=`
    Unequal,
}

/// Longer signs before those that they begin with.
const COMPARISONS: [(&str, Comparison); 6] = [
    ("<=", Comparison::AtMost),
    (">=", Comparison::AtLeast),
    ("==", Comparison::Equal),
    ("!=", Comparison::Unequal),
    ("<", Comparison::Less),
    (">", Comparison::Greater),
];

impl Comparison {
    /// Compares. Nothing but `!=` holds for what is not a number.
    pub fn holds(self, value: f64, with: f64) -> bool {
        match self {
            Self::Less => value < with,
            Self::AtMost => value <= with,
            Self::Greater => value > with,
            Self::AtLeast => value >= with,
            Self::Equal => value == with,
            Self::Unequal => value != with,
        }
    }
}

/// For whoever has written something else.
const FORMS: &str = "write MESSAGE.SIGNAL < NUMBER (or <=, >, >=, ==, !=), MESSAGE, \
                     no MESSAGE for 5s, no frames for 5s, gap, error frame, error frame CLASS, \
                     bus-off, error-passive or error-warning, perhaps with BUS: in front; or mark";

impl Condition {
    /// Reads a condition. The error is a sentence.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = || format!("\"{}\" is not a condition: {FORMS}", text.escape_debug());
        let (bus, rest) = match text.split_once(':') {
            Some((bus, rest)) => (Some(name(bus).ok_or_else(wrong)?), rest),
            None => (None, text),
        };
        let what = match rest.split_whitespace().collect::<Vec<_>>()[..] {
            ["gap"] => What::Gap,
            ["mark"] if bus.is_none() => What::Mark,
            ["error", "frame"] => What::ErrorFrame(None),
            ["error", "frame", class] => error_frame(class)?,
            [class @ ("bus-off" | "error-passive" | "error-warning")] => error_frame(class)?,
            ["no", message, "for", time] => silence(message, time)?.ok_or_else(wrong)?,
            [message] if name(message).is_some() => What::Message(message.to_owned()),
            _ => signal(rest).ok_or_else(wrong)?,
        };
        Ok(Self { bus, what })
    }
}

/// States of the controller, beside what [`error::names`] has.
const STATES: [&str; 2] = ["error-passive", "error-warning"];

fn error_frame(class: &str) -> Result<What, String> {
    let known = || STATES.into_iter().chain(error::names());
    if known().any(|name| name == class) {
        return Ok(What::ErrorFrame(Some(class.to_owned())));
    }
    let all: Vec<&str> = known().collect();
    let class = class.escape_debug();
    Err(format!("there is no class of error frames {class}; there are {}", all.join(", ")))
}

fn silence(message: &str, time: &str) -> Result<Option<What>, String> {
    let nanos = u64::try_from(parse_duration(time)?.as_nanos()).unwrap_or(u64::MAX);
    if nanos == 0 {
        return Err(format!("{time} is too short for a silence"));
    }
    let Some(message) = name(message) else { return Ok(None) };
    let message = Some(message).filter(|message| message != "frames");
    Ok(Some(What::Silence { message, nanos }))
}

fn signal(text: &str) -> Option<What> {
    let at = text.find(['<', '>', '=', '!'])?;
    let (left, right) = text.split_at(at);
    let sign = COMPARISONS.iter().find(|(sign, _)| right.starts_with(sign));
    let (sign, comparison) = *sign?;
    let (message, signal) = left.split_once('.')?;
    let value = right.strip_prefix(sign)?.trim().parse::<f64>().ok();
    let value = value.filter(|value| value.is_finite())?;
    Some(What::Signal { message: name(message)?, signal: name(signal)?, comparison, value })
}

/// A name of a bus, message or signal, without the blanks around it.
fn name(text: &str) -> Option<String> {
    let text = text.trim();
    let fits = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-');
    (!text.is_empty() && text.chars().all(fits)).then(|| text.to_owned())
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(bus) = &self.bus {
            write!(f, "{bus}: ")?;
        }
        match &self.what {
            What::Gap => write!(f, "gap"),
            What::Mark => write!(f, "mark"),
            What::ErrorFrame(None) => write!(f, "error frame"),
            What::ErrorFrame(Some(class)) => write!(f, "error frame {class}"),
            What::Silence { message, nanos } => {
                let message = message.as_deref().unwrap_or("frames");
                write!(f, "no {message} for {}.{:09}", nanos / 1_000_000_000, nanos % 1_000_000_000)
            }
            What::Message(message) => write!(f, "{message}"),
            What::Signal { message, signal, comparison, value } => {
                let sign = COMPARISONS.iter().find(|(_, known)| known == comparison);
                write!(f, "{message}.{signal} {} {value}", sign.map_or("", |(sign, _)| sign))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn conditions_are_read_as_people_write_them() {
        let what = |text: &str| Condition::parse(text).unwrap().what;
        assert_eq!(what("gap"), What::Gap);
        assert_eq!(what(" error  frame "), What::ErrorFrame(None));
        assert_eq!(what("bus-off"), What::ErrorFrame(Some("bus-off".into())));
        assert_eq!(what("error frame stuff"), What::ErrorFrame(Some("stuff".into())));
        let silence = What::Silence { message: Some("BATMON_2".into()), nanos: 5_000_000_000 };
        assert_eq!(what("no BATMON_2 for 5s"), silence);
        assert_eq!(
            what("no frames for 200ms"),
            What::Silence { message: None, nanos: 200_000_000 }
        );
        let low = What::Signal {
            message: "BATMON_3".into(),
            signal: "soc".into(),
            comparison: Comparison::AtMost,
            value: -20.5,
        };
        assert_eq!(what("BATMON_3.soc<=-20.5"), low);
        assert_eq!(Condition::parse("station: BATMON_3.soc <= -2.05e1").unwrap().what, low);
        assert_eq!(Condition::parse("station:gap").unwrap().bus.as_deref(), Some("station"));
    }

    #[test]
    fn what_is_no_condition_is_refused_with_the_forms() {
        for text in [
            "",
            ":",
            "gap gap",
            "no x for",
            "no x for soon",
            "a.b",
            "a.b < ",
            "a.b < c",
            "a.b < nan",
            "a.b < inf",
            "a < 3",
            "a.b = 3",
            "a.b =< 3",
            "a.b < 3 < 4",
            "a.b.c < 3",
            "no a for 0s",
            "x y:gap",
            "a.b ! 3",
            "error frame odd",
        ] {
            assert!(Condition::parse(text).is_err(), "{text}");
        }
        assert!(Condition::parse("a < 3").unwrap_err().contains("MESSAGE.SIGNAL < NUMBER"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in ".{0,60}") {
            let _ = Condition::parse(&text);
        }

        #[test]
        fn what_is_written_is_read_as_the_same(
            bus in proptest::option::of("[a-z][a-z0-9_-]{0,9}"),
            message in "[A-Z][A-Za-z0-9_]{0,9}",
            signal in "[a-z][A-Za-z0-9_]{0,9}",
            sign in 0usize..6,
            value in proptest::num::f64::NORMAL,
            nanos in 1u64..u64::MAX / 2,
            kind in 0u8..3,
        ) {
            let what = match kind {
                0 => What::Message(message),
                1 => What::Silence { message: Some(message), nanos },
                _ => What::Signal { message, signal, comparison: COMPARISONS[sign].1, value },
            };
            let condition = Condition { bus, what };
            prop_assert_eq!(Condition::parse(&condition.to_string()), Ok(condition));
        }
    }
}
