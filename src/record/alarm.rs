//! The triggers of a recording, at work beside the writer.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use super::progress::Progress;
use crate::frame::Level;
use crate::trigger::{Commands, Fired, Triggers};

/// Triggers, and what is done when they fire.
pub struct Alarm {
    triggers: Triggers,
    commands: Option<Commands>,
    fired: Vec<Fired>,
    /// Of those that have fired, which want a window.
    wanted: Vec<Fired>,
    progress: Arc<Progress>,
}

impl Alarm {
    /// Starts to run commands where a trigger has one.
    pub fn new(triggers: Triggers, progress: Arc<Progress>) -> std::io::Result<Self> {
        let commands = if triggers.has_commands() {
            let progress = progress.clone();
            Some(Commands::start(move |text| progress.remark(Level::Warning, text))?)
        } else {
            None
        };
        let (fired, wanted) = (Vec::new(), Vec::new());
        Ok(Self { triggers, commands, fired, wanted, progress })
    }

    /// What has fired since the last call and wants a window.
    pub fn take_wanted(&mut self) -> Vec<Fired> {
        std::mem::take(&mut self.wanted)
    }

    /// Shows something to the triggers, and does what those want that fire. False if they have
    /// failed and must not be asked again.
    pub fn watch(&mut self, show: impl FnOnce(&mut Triggers, &mut Vec<Fired>)) -> bool {
        let Self { triggers, fired, .. } = self;
        let done = catch_unwind(AssertUnwindSafe(|| show(triggers, fired))).is_ok();
        for fired in self.fired.drain(..) {
            if !self.progress.event(fired.event()) {
                let text = format!("trigger {} fires too often; events are lost", fired.name);
                self.progress.remark(Level::Warning, text);
            }
            if fired.window.is_some() {
                self.wanted.push(fired.clone());
            }
            if fired.run.is_empty() {
                continue;
            }
            if self.commands.as_ref().is_none_or(|commands| !commands.run(&fired)) {
                let text = format!(
                    "the command of trigger {} was not run: too many are running already",
                    fired.name
                );
                self.progress.remark(Level::Warning, text);
            }
        }
        done
    }
}
