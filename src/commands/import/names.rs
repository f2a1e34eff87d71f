//! The names that buses of logs have in a recording.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

use anyhow::{Result, bail};

use crate::address::check_name;
use crate::commands::UsageError;
use crate::import::merge::Naming;

/// Renaming as the options ask for.
pub struct Names(Rc<RefCell<State>>);

#[derive(Default)]
struct State {
    /// FROM and TO, and whether FROM was met.
    rules: Vec<(String, String, bool)>,
    /// TO without FROM, and the bus that has it now.
    only: Option<(String, Option<String>)>,
    /// Names of logs that a recording cannot have.
    changed: BTreeMap<String, String>,
    /// By name in the recording the name in the log, but for those that options give.
    given: BTreeMap<String, String>,
}

impl Names {
    /// Reads the options.
    pub fn of(options: &[String]) -> Result<Self> {
        let mut state = State::default();
        for text in options {
            let wrong = |why: String| UsageError(format!("--bus {text}: {why}"));
            let (from, to) =
                text.split_once('=').map_or((None, text.as_str()), |(f, t)| (Some(f), t));
            check_name(to).map_err(wrong)?;
            match from {
                Some(from) => state.rules.push((from.to_owned(), to.to_owned(), false)),
                None if state.only.is_some() => {
                    bail!(UsageError(format!("--bus {text}: only one bus can be the only one")));
                }
                None => state.only = Some((to.to_owned(), None)),
            }
        }
        Ok(Self(Rc::new(RefCell::new(state))))
    }

    /// What names the buses.
    pub fn naming(&self) -> Naming {
        let state = Rc::clone(&self.0);
        Box::new(move |_, name| state.borrow_mut().name(name))
    }

    /// Buses that options name, but no log has.
    pub fn unused(&self) -> Vec<String> {
        let state = self.0.borrow();
        let unused = state.rules.iter().filter(|(.., met)| !met);
        unused.map(|(from, ..)| from.clone()).collect()
    }

    /// Names that had to be changed.
    pub fn changed(&self) -> BTreeMap<String, String> {
        self.0.borrow().changed.clone()
    }
}

impl State {
    fn name(&mut self, name: &str) -> Result<String, String> {
        if let Some((_, to, met)) = self.rules.iter_mut().find(|(from, ..)| from == name) {
            *met = true;
            return Ok(to.clone());
        }
        if let Some((to, owner)) = &mut self.only {
            return match owner {
                Some(other) if other != name => Err(format!(
                    "--bus {to} names one bus, but the logs have {other} and {name}; write \
                     --bus {other}=... --bus {name}=..."
                )),
                _ => {
                    *owner = Some(name.to_owned());
                    Ok(to.clone())
                }
            };
        }
        let fitting = if check_name(name).is_ok() { name.to_owned() } else { fitting(name) };
        let given = self.own(fitting, name);
        if given != name {
            self.changed.insert(name.to_owned(), given.clone());
        }
        Ok(given)
    }

    /// The wish, or the first of `wish_2`, `wish_3` and so on that no other bus has: nobody has said
    /// that they are one.
    fn own(&mut self, wish: String, name: &str) -> String {
        let others = |to: &String| {
            let asked_for = to != name && self.rules.iter().any(|(_, other, _)| other == to);
            asked_for || self.given.get(to).is_some_and(|from| from != name)
        };
        let (mut free, mut number) = (wish.clone(), 1_u32);
        while others(&free) {
            number += 1;
            free = format!("{wish}_{number}");
        }
        self.given.insert(free.clone(), name.to_owned());
        free
    }
}

/// A name that a recording can have.
fn fitting(name: &str) -> String {
    let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    // Short enough for a number behind it.
    let mut fitting: String =
        name.chars().map(|c| if fits(c) { c } else { '_' }).take(56).collect();
    if fitting.is_empty() || fitting.starts_with('.') || fitting == "bustape" {
        fitting.insert(0, '_');
    }
    fitting
}
