//! An slcan adapter as a source of CAN frames. It is never asked to transmit.

use std::cell::RefCell;
use std::io;
use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval, timeout};

use super::address::SlcanAddress;
use super::session::Session;
use super::set_up::set_up;
use crate::capture::serial::SerialSettings;
use crate::capture::serial::last::LastReads;
use crate::capture::serial::open::{Opened, PortSpec, Use};
use crate::capture::serial::port::{Port, READ_BYTES};
use crate::capture::serial::supervise::Outage;
use crate::capture::{BusFacts, CaptureError, Running, Source, Stop};
use crate::frame::{Direction, Level, Unit};
use crate::queue::Inlet;

/// After closing the channel, how long the adapter may take for its last words.
const LAST_WORDS: Duration = Duration::from_millis(100);

/// An adapter that is set up, with its channel still closed.
pub struct Slcan {
    address: SlcanAddress,
    spec: PortSpec,
    ready: Ready,
}

/// An open port with an adapter behind it that is set up.
struct Ready {
    opened: Opened,
    answers: bool,
}

impl Slcan {
    /// Opens the port and sets the adapter up. Takes up to a second or two with adapters that do
    /// not answer.
    pub fn open(address: SlcanAddress) -> Result<Self, CaptureError> {
        let settings = SerialSettings::new(address.baud);
        let (spec, opened) = PortSpec::open_first(address.path.clone(), settings, Use::Adapter)?;
        let answers = set_up(&opened.tty, &address)?;
        Ok(Self { address, spec, ready: Ready { opened, answers } })
    }
}

impl Source for Slcan {
    fn facts(&self) -> BusFacts {
        let mut more = self.spec.facts();
        for (name, text) in [("kind", "slcan"), ("timestamps", "read")] {
            more.insert(name.to_owned(), text.to_owned());
        }
        more.insert("listen_only".to_owned(), self.address.listen.to_string());
        BusFacts {
            unit: Some(Unit::Frames),
            bitrate: Some(self.address.bitrate),
            data_bitrate: self.address.data_bitrate,
            more,
        }
    }

    fn run<'a>(self: Box<Self>, inlet: Inlet, mut stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            let inlet = RefCell::new(inlet);
            let Self { address, spec, mut ready } = *self;
            loop {
                let answers = ready.answers;
                let mut port = Port::new(ready.opened, &spec, Direction::Rx, &inlet)
                    .map_err(|e| CaptureError(format!("cannot wait on an adapter: {e}")))?;
                if !answers {
                    let text = format!(
                        "the adapter at {} does not answer; if no frames come, check that it \
                         speaks slcan and its baud rate",
                        spec.path.display()
                    );
                    inlet.borrow_mut().notice(Level::Warning, text);
                }
                let mut session = Session::new(&address, answers, &inlet);
                let ended = record(&mut port, &mut session, &mut stop).await;
                session.report();
                let Err(why) = ended else { return session.outcome() };
                let since = port.alive();
                drop(port);
                let again = (spec.clone(), address.clone());
                let reopen = move || {
                    let opened = again.0.open_again()?;
                    let answers = set_up(&opened.tty, &again.1)?;
                    Ok(Ready { opened, answers })
                };
                let outage = Outage { stable: &spec.stable, since, why: &why };
                match outage.wait(reopen, &inlet, &mut stop).await {
                    Some(back) => ready = back,
                    None => return Ok(()),
                }
            }
        })
    }
}

/// Opens the channel and records until `stop`, or until the adapter refuses to open it. An error
/// means that the adapter is gone.
async fn record(port: &mut Port, session: &mut Session<'_>, stop: &mut Stop) -> io::Result<()> {
    let mut buffer = vec![0; READ_BYTES];
    let mut second = interval(Duration::from_secs(1));
    second.set_missed_tick_behavior(MissedTickBehavior::Delay);
    second.tick().await;
    port.write_now(session.open_command())?;
    while !session.is_refused() {
        tokio::select! {
            () = stop.requested() => break,
            _ = second.tick() => {
                port.check_overruns(session.inlet());
                if let Some(command) = session.poll_command() {
                    port.write_now(command)?;
                }
            }
            read = port.read(&mut buffer) => {
                let time = session.take(&buffer[..read?]);
                port.heard(time);
            }
        }
    }
    // From here on a failure no longer matters: the recording is complete.
    let _ = port.write_now(b"C\r");
    session.expect_close();
    let last_words = async {
        while !session.is_closed()
            && let Ok(length) = port.read(&mut buffer).await
        {
            session.take(&buffer[..length]);
        }
    };
    let _ = timeout(LAST_WORDS, last_words).await;
    // On a busy machine that time may be over before the first read.
    let mut last = LastReads::new();
    while !session.is_closed()
        && last.more()
        && let Ok(length @ 1..) = port.read_now(&mut buffer)
    {
        session.take(&buffer[..length]);
        last.took(length);
    }
    port.check_overruns(session.inlet());
    Ok(())
}
