//! What a recorder would have to wait for: the disk's answer to a sync, and a file's final name.
//!
//! A card may take seconds for a sync. The writer does not wait for that: it goes on, so that what is
//! received meanwhile reaches the file, where a kill cannot take it away any more. Each row of
//! files has one thread, which does one job after the other, so files become safe in their order.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::segments::{SegmentError, rename_error, write_error};
use crate::frame::Timestamp;
use crate::recording::disk::{Disk, Durable, folder_of};

/// Something to be waited for.
pub enum Job {
    /// What was written to a file up to now shall survive a power cut.
    Sync {
        /// Its name while it is open.
        part: PathBuf,
        /// The file.
        file: Arc<dyn Durable>,
        /// It is new: so shall its name.
        new: bool,
        /// Everything before this moment is in it.
        time: Timestamp,
    },
    /// A file whose end is written gets its name.
    Finish {
        /// Its name while it is open.
        part: PathBuf,
        /// The name it gets.
        path: PathBuf,
        /// The file.
        file: Arc<dyn Durable>,
    },
}

/// What has become of a job.
pub enum Done {
    /// What was before a moment is safe.
    Synced {
        /// The file's name while it is open.
        part: PathBuf,
        /// The moment.
        time: Timestamp,
    },
    /// What was written to a file may not be on the disk. It will not get its name.
    Unsafe {
        /// Its name while it is open.
        part: PathBuf,
        /// What went wrong.
        error: SegmentError,
    },
    /// A file is finished under this name.
    Finished(PathBuf),
    /// A file could not be finished.
    Unfinished(SegmentError),
}

/// The thread, once there is something to do.
pub struct DiskThread {
    disk: Arc<dyn Disk>,
    thread: Option<(Sender<Job>, Receiver<Done>)>,
    /// Works where the system has no thread to give: then the writer has to wait, after all.
    instead: Worker,
    /// How many jobs are under way.
    jobs: usize,
    /// Done without a thread, since none could be had.
    done: Vec<Done>,
}

impl DiskThread {
    /// Nothing to do yet.
    pub fn new(disk: Arc<dyn Disk>) -> Self {
        let instead = Worker::new(disk.clone());
        Self { disk, thread: None, instead, jobs: 0, done: Vec::new() }
    }

    /// How many jobs have to be waited for.
    pub fn jobs(&self) -> usize {
        self.jobs
    }

    /// Gives it something to do.
    pub fn give(&mut self, job: Job) {
        if self.thread.is_none() {
            self.thread = start(self.disk.clone());
        }
        self.jobs += 1;
        let refused = match &self.thread {
            Some((jobs, _)) => jobs.send(job).err().map(|error| error.0),
            None => Some(job),
        };
        if let Some(job) = refused {
            self.done.push(self.instead.work(job));
        }
    }

    /// What was done since it was last asked.
    pub fn take_done(&mut self) -> Vec<Done> {
        if let Some((_, done)) = &self.thread {
            self.done.extend(done.try_iter());
        }
        self.jobs -= self.done.len().min(self.jobs);
        std::mem::take(&mut self.done)
    }

    /// Waits until all is done.
    pub fn wait(&mut self) -> Vec<Done> {
        if let Some((_, done)) = &self.thread {
            let waiting = self.jobs.saturating_sub(self.done.len());
            self.done.extend(done.iter().take(waiting));
        }
        self.jobs = 0;
        std::mem::take(&mut self.done)
    }
}

/// `None` where the system has no thread to give.
fn start(disk: Arc<dyn Disk>) -> Option<(Sender<Job>, Receiver<Done>)> {
    let (give, jobs) = channel();
    let (tell, done) = channel();
    let work = move || {
        let mut worker = Worker::new(disk);
        for job in jobs {
            if tell.send(worker.work(job)).is_err() {
                return;
            }
        }
    };
    std::thread::Builder::new().name("disk".to_owned()).spawn(work).ok()?;
    Some((give, done))
}

/// Does the work.
struct Worker {
    disk: Arc<dyn Disk>,
    /// Files of which a sync has failed. Another one might succeed, and prove nothing: the kernel tells an
    /// error once, and may have thrown away what it could not write (fsync(2), errors).
    bad: BTreeSet<PathBuf>,
}

impl Worker {
    fn new(disk: Arc<dyn Disk>) -> Self {
        Self { disk, bad: BTreeSet::new() }
    }

    fn work(&mut self, job: Job) -> Done {
        match job {
            Job::Sync { part, file, new, time } => {
                let synced = file.sync().and_then(|()| {
                    if new { self.disk.sync_folder(folder_of(&part)) } else { Ok(()) }
                });
                match synced {
                    Ok(()) => Done::Synced { part, time },
                    Err(error) => {
                        self.bad.insert(part.clone());
                        Done::Unsafe { error: write_error(&part, &error), part }
                    }
                }
            }
            Job::Finish { part, path, file } => {
                let synced = if self.bad.remove(&part) {
                    Err(std::io::Error::other("an earlier sync of it has failed"))
                } else {
                    file.sync()
                };
                let finished = synced.map_err(|error| write_error(&part, &error)).and_then(|()| {
                    let named = self.disk.rename(&part, &path);
                    named.map_err(|error| rename_error(&part, &path, &error))
                });
                match finished {
                    Ok(()) => Done::Finished(path),
                    Err(error) => Done::Unfinished(error),
                }
            }
        }
    }
}
