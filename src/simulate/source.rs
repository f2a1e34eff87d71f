//! The simulated devices as sources: the only part of the simulation that knows real time.

use std::time::Duration;

use tokio::time::{Instant, sleep_until};

use super::hmi_can::fault::BusFaults;
use super::hmi_can::{BIT_RATE, HmiCan};
use crate::capture::{BusFacts, Running, Source, Stop};
use crate::frame::{Frame, Unit};
use crate::queue::Inlet;

/// A day in a minute: what a demo shows unless told otherwise.
pub const DEMO_TIME_SCALE: f64 = 1440.0;

/// The bus of the simulated solar power station (`sim:hmi-can`).
pub struct SimulatedCan {
    bus: HmiCan,
    life: Life,
}

/// What every simulated bus is made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Life {
    /// Another number is another life.
    pub seed: u64,
    /// How many times faster than real time a day passes.
    pub time_scale: f64,
}

impl Default for Life {
    /// The same for everybody, so that two people see the same recording: one with clouds, a mains
    /// failure and a generator start in its first minute.
    fn default() -> Self {
        Self { seed: 13, time_scale: DEMO_TIME_SCALE }
    }
}

impl SimulatedCan {
    /// The station of one life.
    pub fn new(life: Life, faults: BusFaults) -> Self {
        let bus = HmiCan::new(life.seed, life.time_scale).with_faults(faults);
        Self { bus, life }
    }

    async fn play(mut self, mut inlet: Inlet, mut stop: Stop) {
        // Every frame against the start, so that late timers do not add up.
        let start = Instant::now();
        loop {
            let (offset, frames) = self.bus.step();
            tokio::select! {
                () = sleep_until(start + Duration::from_nanos(offset)) => {}
                () = stop.requested() => return,
            }
            for frame in frames {
                let time = inlet.timeline().now();
                inlet.push_one(time, Frame::Can(frame));
            }
            if inlet.satisfied() {
                return;
            }
        }
    }
}

impl Source for SimulatedCan {
    fn facts(&self) -> BusFacts {
        let more = simulated(self.life);
        BusFacts { unit: Some(Unit::Frames), bitrate: Some(BIT_RATE), data_bitrate: None, more }
    }

    fn run<'a>(self: Box<Self>, inlet: Inlet, stop: Stop) -> Running<'a>
    where
        Self: 'a,
    {
        Box::pin(async move {
            self.play(inlet, stop).await;
            Ok(())
        })
    }
}

/// What every simulated bus says of itself.
pub(super) fn simulated(life: Life) -> std::collections::BTreeMap<String, String> {
    let facts = [
        ("kind", "simulated".to_string()),
        ("seed", life.seed.to_string()),
        ("time_scale", life.time_scale.to_string()),
    ];
    facts.map(|(name, value)| (name.to_string(), value)).into()
}

#[cfg(test)]
pub(super) mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::clock::{Clock, Reading, Timeline};
    use crate::frame::Stamped;
    use crate::queue::{Allowance, Queue, Tally};
    use crate::simulate::hmi_can::fault::FAULTS;

    /// Where the clock of these tests begins, ns since 1970.
    const BEGIN: u64 = 1_700_000_000_000_000_000;

    /// The machine's steady clock, put at a fixed day.
    struct Ticking(std::time::Instant);

    impl Clock for Ticking {
        fn read(&self) -> Reading {
            let steady = self.0.elapsed().as_nanos() as u64;
            Reading { wall: BEGIN + steady, steady }
        }
    }

    /// Runs `source` until it has recorded `count` frames or bytes, or for ten seconds at most.
    pub fn record(source: Box<dyn Source>, count: u64) -> Vec<Stamped<Frame>> {
        let queue = Queue::new(1 << 20);
        let (tally, allowance) = (Arc::new(Tally::default()), Allowance::new(Some(count)));
        let timeline = Timeline::start(Arc::new(Ticking(std::time::Instant::now())));
        let unit = source.facts().unit.expect("no unit");
        let inlet = Inlet::new(0, unit, queue.clone(), tally.clone(), allowance, timeline);
        let (switch, stop) = Stop::new();
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().expect("no runtime");
        runtime.block_on(async {
            let running = source.run(inlet, stop);
            tokio::select! {
                result = running => result.expect("the source failed"),
                () = tokio::time::sleep(Duration::from_secs(10)) => panic!("still not {count}"),
            }
        });
        drop(switch);
        let mut items = Vec::new();
        queue.take(&mut items, usize::MAX, Duration::ZERO);
        items.into_iter().map(|item| item.frame).collect()
    }

    #[test]
    fn the_bus_is_recorded_in_real_time_and_in_order() {
        let source =
            SimulatedCan::new(Life { seed: 1, ..Life::default() }, BusFaults::none(FAULTS));
        assert_eq!(source.facts().more["kind"], "simulated");
        let frames = record(Box::new(source), 40);
        let mut last = 0;
        for (stamped, (offset, frame)) in frames.iter().zip(HmiCan::new(1, DEMO_TIME_SCALE)) {
            assert_eq!(stamped.value, Frame::Can(frame));
            let time = stamped.time.nanos() - BEGIN;
            assert!(time >= offset, "a frame of {offset} ns came at {time}");
            assert!(time >= last);
            last = time;
        }
        assert_eq!(frames.len(), 40);
    }

    #[test]
    fn a_stop_ends_the_source_at_once() {
        let queue = Queue::new(1 << 20);
        let timeline = Timeline::start(Arc::new(Ticking(std::time::Instant::now())));
        let (tally, allowance) = (Arc::new(Tally::default()), Allowance::new(Some(1000)));
        let inlet = Inlet::new(0, Unit::Frames, queue, tally.clone(), allowance, timeline);
        let (switch, stop) = Stop::new();
        switch.send_replace(true);
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().expect("no runtime");
        let running =
            Box::new(SimulatedCan::new(Life::default(), BusFaults::none(FAULTS))).run(inlet, stop);
        runtime.block_on(running).expect("the source failed");
        assert!(tally.totals().received < 1000, "it went on until --count was reached");
    }
}
