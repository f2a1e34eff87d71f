//! Conditions over the numbers of a frame.

/// Who sent a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The one that asks.
    Request,
    /// The one that answers.
    Response,
}

impl Side {
    /// The side's name in a definition.
    pub fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Response => "response",
        }
    }
}

/// What a condition looks at.
#[derive(Clone, Copy, Debug)]
pub enum Subject {
    /// Who sent the frame.
    Side,
    /// A number, by its place among the frame's numbers.
    Number(usize),
}

/// All of the terms must hold.
#[derive(Clone, Debug, Default)]
pub struct Condition {
    /// What is looked at, and the values it may have ([`Side`]: 0 for requests, 1 for responses).
    pub terms: Vec<(Subject, Vec<u64>)>,
}

impl Condition {
    /// True when nothing is asked for.
    pub fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// True when every term holds; `number` gives the frame's numbers.
    pub fn holds(&self, side: Option<Side>, number: impl Fn(usize) -> Option<u64>) -> bool {
        self.terms.iter().all(|(subject, values)| {
            let value = match subject {
                Subject::Side => side.map(|side| side as u64),
                Subject::Number(index) => number(*index),
            };
            value.is_some_and(|value| values.contains(&value))
        })
    }
}
