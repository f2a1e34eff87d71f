//! A bus that is not there when the recording begins: a gap from the start, until it is.

use std::time::Duration;

use tokio::time::{Instant, sleep};

use super::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{GapReason, Level, Unit};
use crate::queue::Inlet;

/// How often it is looked for.
const LOOK: Duration = Duration::from_millis(250);
/// A reason that changes is told when it has stayed for this long: just after plugging in, udev has
/// not given a device its permissions yet.
const PATIENCE: Duration = Duration::from_secs(2);

/// How a bus is opened.
pub struct Opener {
    /// A quick look whether it is worth to try.
    pub is_there: Box<dyn Fn() -> bool + Send + Sync>,
    /// Opens it.
    pub open: Box<dyn Fn() -> Result<Box<dyn Source>, CaptureError> + Send + Sync>,
}

/// A bus that is not there yet.
pub struct Awaited {
    opener: std::sync::Arc<Opener>,
    unit: Unit,
    /// Why it could not be opened.
    why: CaptureError,
}

impl Awaited {
    /// Waits for what could not be opened because of `why`, and counts its loss in `unit`.
    pub fn new(opener: Opener, unit: Unit, why: CaptureError) -> Self {
        Self { opener: opener.into(), unit, why }
    }

    /// Returns the bus as soon as it can be opened.
    async fn come(&self, inlet: &mut Inlet) -> Box<dyn Source> {
        let mut told = self.why.to_string();
        let mut changed: Option<(String, Instant)> = None;
        loop {
            sleep(LOOK).await;
            if !(self.opener.is_there)() {
                continue;
            }
            let opener = self.opener.clone();
            // On a thread of its own, because opening some adapters takes seconds.
            let opened = tokio::task::spawn_blocking(move || (opener.open)()).await;
            let why = match opened {
                Ok(Ok(source)) => return source,
                Ok(Err(why)) => why.to_string(),
                Err(error) => error.to_string(),
            };
            if why == told {
                changed = None;
                continue;
            }
            match &changed {
                Some((text, since)) if *text == why => {
                    if since.elapsed() >= PATIENCE {
                        inlet.notice(Level::Warning, why.clone());
                        (told, changed) = (why, None);
                    }
                }
                _ => changed = Some((why, Instant::now())),
            }
        }
    }
}

impl Source for Awaited {
    fn facts(&self) -> BusFacts {
        let mut facts = BusFacts { unit: Some(self.unit), ..BusFacts::default() };
        facts.more.insert("missing_at_start".to_owned(), self.why.to_string());
        facts
    }

    fn run<'a>(self: Box<Self>, mut inlet: Inlet, mut stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            let from = inlet.timeline().now();
            inlet.notice(Level::Warning, format!("{}; it is waited for", self.why));
            let source = tokio::select! {
                () = stop.requested() => None,
                source = self.come(&mut inlet) => Some(source),
            };
            let to = inlet.timeline().now();
            inlet.gap(GapReason::LinkDown, 0, from, to);
            let Some(source) = source else { return Ok(()) };
            let seconds = Duration::from_nanos(to.since(from)).as_secs_f64();
            let facts = source.facts();
            // The head of the file is written already.
            let about = facts.more.iter().map(|(name, text)| format!("{name} {text}"));
            let rate = facts.bitrate.map(|rate| format!("bitrate {rate}"));
            let about: Vec<String> = rate.into_iter().chain(about).collect();
            let text = format!("there it is, after {seconds:.1} s: {}", about.join(", "));
            inlet.notice(Level::Info, text);
            source.run(inlet, stop).await
        })
    }
}
