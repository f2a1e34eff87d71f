//! What a running recorder shows and hears: its status file, and the socket for marks.

use std::fs::Permissions;
use std::io::ErrorKind;
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};
use tokio::net::{UnixListener, UnixStream};

use super::plan::Plan;
use crate::cli::LONGEST_MARK;
use crate::clock::Timeline;
use crate::commands::mark::TAKEN;
use crate::commands::running;
use crate::frame::{GapReason, Timestamp, Unit};
use crate::queue::Totals;
use crate::record::{Progress, State, Target};
use crate::recording::disk::{Disk as _, RealDisk, folder_of};
use crate::recording::event::Event;
use crate::text::rfc3339;

/// How long somebody who connects may take to say something.
const PATIENCE: Duration = Duration::from_secs(1);
const SECOND: u64 = 1_000_000_000;

/// The files of this recorder in the folder of those that run. Dropping it removes them.
pub struct Board {
    name: String,
    status: PathBuf,
    socket: PathBuf,
    folder: PathBuf,
    started: Timestamp,
    before: Option<(Timestamp, Vec<Totals>)>,
    /// The file is being written at this moment.
    busy: Arc<AtomicBool>,
}

impl Board {
    /// Makes the socket.
    pub fn new(plan: &Plan, started: Timestamp) -> Result<(Self, UnixListener)> {
        let (status, socket) = running::files(&running::own_folder()?, std::process::id());
        let about = || format!("cannot listen at {}", socket.display());
        let listener = match UnixListener::bind(&socket) {
            // Of an earlier process with our number.
            Err(error) if error.kind() == ErrorKind::AddrInUse => {
                std::fs::remove_file(&socket).with_context(about)?;
                UnixListener::bind(&socket)
            }
            bound => bound,
        };
        let listener = listener.with_context(about)?;
        std::fs::set_permissions(&socket, Permissions::from_mode(0o600)).with_context(about)?;
        let (name, folder) = match &plan.target {
            Target::Folder(folder, name) => (name.clone(), folder.clone()),
            Target::File(file) => {
                let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                (name, folder_of(file).to_owned())
            }
        };
        let busy = Arc::default();
        Ok((Self { name, status, socket, folder, started, before: None, busy }, listener))
    }

    /// Replaces the status file, once a second. The disk is not waited for: while it does not
    /// answer, the status stays as it was.
    pub fn show(
        &mut self,
        now: Timestamp,
        buses: &[(String, Unit)],
        totals: &[Totals],
        state: &State,
    ) {
        if self.before.as_ref().is_some_and(|(then, _)| now.since(*then) < SECOND)
            || self.busy.swap(true, Relaxed)
        {
            return;
        }
        let mut status = self.describe(now, buses, totals, state);
        self.before = Some((now, totals.to_vec()));
        let (path, folder, busy) = (self.status.clone(), self.folder.clone(), self.busy.clone());
        tokio::task::spawn_blocking(move || {
            status["free_bytes"] = json!(RealDisk.free(&folder).ok());
            // Who reads it sees the old one or the new one. A failure leaves the old one.
            let new = path.with_extension("new");
            let open = std::fs::OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(true)
                .mode(0o644)
                .open(&new);
            let written = open.and_then(|mut file| {
                std::io::Write::write_all(&mut file, status.to_string().as_bytes())
            });
            if written.is_ok() {
                std::fs::rename(&new, &path).ok();
            }
            busy.store(false, Relaxed);
        });
    }

    fn describe(
        &self,
        now: Timestamp,
        buses: &[(String, Unit)],
        totals: &[Totals],
        state: &State,
    ) -> Value {
        let bus = |(index, ((name, unit), totals)): (usize, (&(String, Unit), &Totals))| {
            let rate = self.before.as_ref().and_then(|(then, before)| {
                let count = totals.received.saturating_sub(before.get(index)?.received);
                Some(count as f64 * SECOND as f64 / now.since(*then).max(1) as f64)
            });
            let dropped = GapReason::ALL.into_iter().filter(|reason| totals.lost_to(*reason) > 0);
            let dropped: serde_json::Map<_, _> = dropped
                .map(|reason| (reason.name().to_owned(), json!(totals.lost_to(reason))))
                .collect();
            json!({
                "bus": name,
                "unit": unit.name(),
                "rate": rate.unwrap_or(0.0),
                "received": totals.received,
                "written": totals.written,
                "dropped": totals.lost(),
                "dropped_by_reason": dropped,
                "outages": totals.outages,
            })
        };
        json!({
            "name": self.name,
            "pid": std::process::id(),
            "version": env!("CARGO_PKG_VERSION"),
            "started": rfc3339(self.started),
            "time": rfc3339(now),
            "uptime_s": now.since(self.started) / SECOND,
            "buses": buses.iter().zip(totals).enumerate().map(bus).collect::<Vec<_>>(),
            "file": state.file,
            "file_bytes": state.file_bytes,
            "bytes": state.earlier_bytes + state.file_bytes,
            "synced": state.synced.map(rfc3339),
            "synced_ms_ago": state.synced.map(|synced| now.since(synced) / 1_000_000),
            "queued_bytes": state.queued,
        })
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        std::fs::remove_file(&self.status).ok();
        std::fs::remove_file(&self.socket).ok();
    }
}

/// Takes marks, one after the other, until it is dropped.
pub async fn hear(listener: UnixListener, progress: Arc<Progress>, timeline: Timeline) {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                let take = take(stream, &progress, &timeline);
                // Who connects and says nothing is `bustape status`, or not worth waiting for.
                tokio::time::timeout(PATIENCE, take).await.ok();
            }
            // Too many open files, for example: that passes.
            Err(_) => tokio::time::sleep(PATIENCE).await,
        }
    }
}

async fn take(stream: UnixStream, progress: &Progress, timeline: &Timeline) -> Option<()> {
    let time = timeline.now();
    let mut bytes = vec![0; LONGEST_MARK + 1];
    let mut length = 0;
    while length < bytes.len() {
        stream.readable().await.ok()?;
        match stream.try_read(bytes.get_mut(length..)?) {
            Ok(0) => break,
            Ok(count) => length += count,
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return None,
        }
    }
    bytes.truncate(length);
    let answer = match String::from_utf8(bytes) {
        Ok(text) if text.is_empty() => return None,
        Ok(text) if text.len() <= LONGEST_MARK => {
            let event = Event::new(time, "mark", vec![("text", text)]);
            if progress.event(event) { TAKEN } else { "too many marks wait for the disk\n" }
        }
        _ => "the text is too long, or is not UTF-8\n",
    };
    // So short an answer fits into the socket's buffer, or nobody is there any more.
    stream.writable().await.ok()?;
    stream.try_write(answer.as_bytes()).ok().map(|_| ())
}
