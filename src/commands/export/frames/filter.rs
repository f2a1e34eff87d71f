//! Which frames an export takes.

use anyhow::{Result, bail};

use super::super::selection::Selection;
use crate::capture::socketcan::CanSettings;
use crate::commands::UsageError;
use crate::commands::cat::select::parse_filter;
use crate::frame::Frame;

/// Buses by name, and candump's filters.
pub struct Filter {
    selection: Selection,
    rules: Vec<Rule>,
    /// For each bus of the output its filters, in their order.
    of_bus: Vec<CanSettings>,
    met: Vec<String>,
}

struct Rule {
    text: String,
    bus: String,
    settings: CanSettings,
    met: bool,
}

impl Filter {
    /// Reads the options.
    pub fn of(options: &[String], selection: &Selection) -> Result<Self> {
        let rule = |text: &String| {
            let (bus, settings) = parse_filter(text)?;
            Ok(Rule { text: text.clone(), bus, settings, met: false })
        };
        let rules = options.iter().map(rule).collect::<Result<_>>()?;
        Ok(Self { selection: selection.clone(), rules, of_bus: Vec::new(), met: Vec::new() })
    }

    /// True for a bus that is wanted. Each is asked for once, in the order of the output.
    pub fn wants(&mut self, name: &str) -> bool {
        self.met.push(name.to_owned());
        if !self.selection.bus(name) {
            return false;
        }
        if self.rules.is_empty() {
            self.of_bus.push(CanSettings::default());
            return true;
        }
        let Some(rule) = self.rules.iter_mut().find(|rule| rule.bus == name) else { return false };
        rule.met = true;
        self.of_bus.push(rule.settings.clone());
        true
    }

    /// True for a frame that is wanted, of a bus of the output.
    pub fn passes(&self, bus: usize, frame: &Frame) -> bool {
        match (frame, self.of_bus.get(bus)) {
            (Frame::Can(can), Some(settings)) => self.rules.is_empty() || settings.passes(can),
            _ => true,
        }
    }

    /// An error if an option names a bus that is not there.
    pub fn check_all_met(&self) -> Result<()> {
        if let Some(rule) = self.rules.iter().find(|rule| !rule.met) {
            bail!(UsageError(format!(
                "--filter {}: there is no bus {}, only {}",
                rule.text,
                rule.bus,
                self.met.join(", ")
            )));
        }
        Ok(())
    }
}
