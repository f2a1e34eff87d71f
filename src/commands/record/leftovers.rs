//! What an earlier recording left unfinished is recovered beside the one that begins.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;

use crate::commands::record::Plan;
use crate::frame::Level;
use crate::record::leftovers::{Recovered, leftovers, nothing_in, recover_in_place};
use crate::record::{Progress, Target, WINDOWS};
use crate::recording::disk::{Disk as _, RealDisk};
use crate::text::size;

/// What stays free beside the copy while it is made.
const SPARE: u64 = 16 << 20;

/// Files to be recovered; found before the recorder makes its own.
pub struct Leftovers {
    files: Vec<PathBuf>,
    folder: PathBuf,
    min_free: u64,
}

/// The thread at work. Dropping it stops it; the file it is at stays as it was.
pub struct AtWork {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Leftovers {
    /// Looks into the folder that is recorded into.
    pub fn find(plan: &Plan) -> Self {
        let folder = match &plan.target {
            Target::Folder(folder, _) => folder.clone(),
            Target::File(_) => PathBuf::new(),
        };
        // A folder that cannot be read is said by whoever creates the first segment in it.
        let mut files = leftovers(&folder).unwrap_or_default();
        files.extend(leftovers(&folder.join(WINDOWS)).unwrap_or_default());
        let min_free = plan.limits.as_ref().map_or(0, |limits| limits.min_free);
        Self { files, folder, min_free }
    }

    /// Recovers them one by one, with less right to the processor than everything else.
    pub fn recover(self, progress: Arc<Progress>) -> AtWork {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        if self.files.is_empty() {
            return AtWork { stop, thread: None };
        }
        let work = move || {
            crate::sys::yield_to_others();
            for file in &self.files {
                if stopped.load(Relaxed) {
                    return;
                }
                self.one(file, &progress, &stopped);
            }
        };
        // Without a thread they wait for the next start.
        let thread = std::thread::Builder::new().name("leftovers".to_owned()).spawn(work).ok();
        AtWork { stop, thread }
    }

    fn one(&self, file: &Path, progress: &Progress, stop: &AtomicBool) {
        let name = file.display();
        let needed = file.metadata().map_or(0, |about| about.len()) + self.min_free + SPARE;
        let free = RealDisk.free(&self.folder).unwrap_or(u64::MAX);
        if free < needed {
            let text = format!(
                "{name} was left unfinished and stays so: its recovery needs {} free, there are {}; \
                 make room, then run \"bustape recover --in-place {name}\"",
                size(needed),
                size(free)
            );
            return progress.remark(Level::Warning, text);
        }
        match recover_in_place(file, &mut |_| !stop.load(Relaxed)) {
            Ok(Recovered::Anew { file: new, aside, report }) => {
                let original = aside.map_or(String::new(), |aside| {
                    format!("; the original is now {}", aside.display())
                });
                let text = format!(
                    "{name} was recovered as {}: {}{original}",
                    new.display(),
                    report.sentence()
                );
                let level = if report.is_whole() { Level::Info } else { Level::Warning };
                progress.remark(level, text);
            }
            Ok(Recovered::Nothing { aside }) => {
                progress.remark(Level::Info, nothing_in(file, aside.as_deref()));
            }
            Ok(Recovered::Sound(_) | Recovered::Stopped) => {}
            Err(error) => {
                progress.remark(Level::Warning, format!("{name} was not recovered: {error}"));
            }
        }
    }
}

impl AtWork {
    /// Tells it to end soon.
    pub fn stop(&self) {
        self.stop.store(true, Relaxed);
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}
