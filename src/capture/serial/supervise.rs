//! What happens when a device goes away: one gap, and waiting until it is back.

use std::cell::RefCell;
use std::path::Path;
use std::time::Duration;

use tokio::time::{Instant, sleep};

use crate::capture::{CaptureError, Stop};
use crate::frame::{GapReason, Level, Timestamp};
use crate::queue::Inlet;

/// How often to look for a device that is away. A look is one stat(2).
const LOOK: Duration = Duration::from_millis(200);

/// A device that is there but cannot be opened is reported after this long: just after plugging
/// in, udev has not given it its permissions yet.
const PATIENCE: Duration = Duration::from_secs(2);

/// A device that went away.
pub(crate) struct Outage<'a> {
    /// Where it will come back.
    pub stable: &'a Path,
    /// The last moment at which it was there.
    pub since: Timestamp,
    /// What the kernel said.
    pub why: &'a std::io::Error,
}

impl Outage<'_> {
    /// Waits until `reopen` succeeds or `stop`, and records the outage as one gap either way.
    /// `None` after `stop`.
    ///
    /// The caller has closed the device: an open descriptor would keep its name busy. `reopen`
    /// runs on a thread of its own, because opening some USB adapters takes seconds.
    pub async fn wait<T, F>(self, reopen: F, inlet: &RefCell<Inlet>, stop: &mut Stop) -> Option<T>
    where
        T: Send + 'static,
        F: Fn() -> Result<T, CaptureError> + Clone + Send + 'static,
    {
        let name = self.stable.display();
        let text = format!("{name} went away ({}); waiting until it is back", self.why);
        inlet.borrow_mut().notice(Level::Warning, text);
        let back = tokio::select! {
            () = stop.requested() => None,
            back = come_back(self.stable, reopen, inlet) => Some(back),
        };
        let mut inlet = inlet.borrow_mut();
        let now = inlet.timeline().now();
        inlet.gap(GapReason::LinkDown, 0, self.since, now);
        if back.is_some() {
            let seconds = Duration::from_nanos(now.since(self.since)).as_secs_f64();
            inlet.notice(Level::Info, format!("{name} is back after {seconds:.1} s"));
        }
        back
    }
}

async fn come_back<T, F>(path: &Path, reopen: F, inlet: &RefCell<Inlet>) -> T
where
    T: Send + 'static,
    F: Fn() -> Result<T, CaptureError> + Clone + Send + 'static,
{
    let (mut there_since, mut reported) = (None, None);
    loop {
        sleep(LOOK).await;
        if !path.exists() {
            there_since = None;
            continue;
        }
        let since = *there_since.get_or_insert_with(Instant::now);
        match tokio::task::spawn_blocking(reopen.clone()).await {
            Ok(Ok(open)) => return open,
            Ok(Err(error)) if since.elapsed() >= PATIENCE => {
                let text = error.to_string();
                if reported.as_ref() != Some(&text) {
                    inlet.borrow_mut().notice(Level::Warning, text.clone());
                    reported = Some(text);
                }
            }
            Ok(Err(_)) | Err(_) => {}
        }
    }
}
