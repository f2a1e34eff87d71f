//! Reads ahead of the player, on a thread of its own, so that unpacking a chunk makes no frame
//! late. What it holds is bounded.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::thread::Scope;
use std::time::Duration;

use super::select::Selection;
use super::tally::Omitted;
use crate::frame::{Frame, Timestamp};
use crate::recording::reader::{Entry, Recording};

/// Most items of a batch.
const BATCH_ITEMS: usize = 512;
/// Items of the first one, so that the first frame is there soon.
const FIRST_ITEMS: usize = 16;
/// Most payload bytes of a batch of serial pieces.
const BATCH_BYTES: usize = 256 << 10;
/// Most items passed over without a word to the player.
const MOST_PASSED: u64 = 10_000;
/// Batches between reader and player.
const AHEAD: usize = 8;
/// From the last frame of a lap to the first of the next, nanoseconds.
const BETWEEN_LAPS: u64 = 1_000_000;

/// Something to play.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// When, in nanoseconds since the start of what is played.
    pub media: u64,
    /// When it was recorded.
    pub time: Timestamp,
    /// Number of the bus among those played.
    pub bus: usize,
    /// What.
    pub frame: Frame,
}

/// A bus that is played.
#[derive(Clone, Debug)]
pub struct FedBus {
    /// Its name in the recording.
    pub name: String,
    /// What of it is played.
    pub selection: Selection,
}

/// What is read.
#[derive(Clone, Debug)]
pub struct FeedPlan {
    /// The buses, by number.
    pub buses: Vec<FedBus>,
    /// From when to when.
    pub range: RangeInclusive<Timestamp>,
    /// How often, or without end.
    pub laps: Option<u64>,
    /// Longer pauses become so long, nanoseconds.
    pub max_gap: Option<u64>,
}

/// Where reading begins.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Recorded time.
    pub from: Timestamp,
    /// Laps played before this one.
    pub lap: u64,
    /// Media time of the first item found.
    pub media: u64,
}

/// Some items, and what was found on the way.
#[derive(Debug, Default)]
struct Batch {
    items: Vec<Item>,
    lap: u64,
    /// By bus.
    omitted: Vec<Omitted>,
    /// What could not be read, a sentence each.
    damage: Vec<String>,
}

/// Whether there is something to play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// There is, due at this media time.
    At(u64),
    /// The reader has not got there yet.
    NotYet,
    /// Everything was played.
    End,
}

/// Items in time order.
pub struct Feed {
    batches: Receiver<Batch>,
    items: std::iter::Peekable<std::vec::IntoIter<Item>>,
    lap: u64,
    omitted: Vec<Omitted>,
    damage: Vec<String>,
}

impl Feed {
    /// Starts to read at `place`.
    pub fn start<'scope, 'env>(
        scope: &'scope Scope<'scope, 'env>,
        recording: &'env Recording,
        plan: &'env FeedPlan,
        place: Place,
    ) -> Self {
        let (sender, batches) = sync_channel(AHEAD);
        scope.spawn(move || Reader::new(recording, plan, place, sender).run());
        Self {
            batches,
            items: Vec::new().into_iter().peekable(),
            lap: place.lap,
            omitted: vec![Omitted::default(); plan.buses.len()],
            damage: Vec::new(),
        }
    }

    /// When the next item is due. Does not wait.
    pub fn look(&mut self) -> Next {
        loop {
            if let Some(item) = self.items.peek() {
                return Next::At(item.media);
            }
            match self.batches.try_recv() {
                Ok(batch) => self.enter(batch),
                Err(TryRecvError::Empty) => return Next::NotYet,
                Err(TryRecvError::Disconnected) => return Next::End,
            }
        }
    }

    /// Waits for the reader, but not for longer than `patience`.
    pub fn wait(&mut self, patience: Duration) {
        match self.batches.recv_timeout(patience) {
            Ok(batch) => self.enter(batch),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
    }

    /// The next item, if it is there.
    pub fn take(&mut self) -> Option<Item> {
        self.items.next()
    }

    /// The bus of the next item, if it is there.
    pub fn bus(&mut self) -> Option<usize> {
        self.items.peek().map(|item| item.bus)
    }

    /// Laps played before the one whose items are given out now.
    pub fn lap(&self) -> u64 {
        self.lap
    }

    /// What was left out since the last call, by bus.
    pub fn take_omitted(&mut self) -> Vec<Omitted> {
        let none = vec![Omitted::default(); self.omitted.len()];
        std::mem::replace(&mut self.omitted, none)
    }

    /// What could not be read since the last call.
    pub fn take_damage(&mut self) -> Vec<String> {
        std::mem::take(&mut self.damage)
    }

    fn enter(&mut self, batch: Batch) {
        for (sum, more) in self.omitted.iter_mut().zip(&batch.omitted) {
            sum.merge(more);
        }
        self.damage.extend(batch.damage);
        self.lap = batch.lap;
        self.items = batch.items.into_iter().peekable();
    }
}

/// The reading side.
struct Reader<'a> {
    recording: &'a Recording,
    plan: &'a FeedPlan,
    place: Place,
    /// Number of each recorded bus among those played.
    numbers: Vec<Option<usize>>,
    sender: SyncSender<Batch>,
    batch: Batch,
    bytes: usize,
    first: bool,
    /// Said already, in an earlier lap.
    known: BTreeSet<String>,
}

/// Nobody listens any more.
struct Gone;

impl<'a> Reader<'a> {
    fn new(
        recording: &'a Recording,
        plan: &'a FeedPlan,
        place: Place,
        sender: SyncSender<Batch>,
    ) -> Self {
        let number = |name: &String| plan.buses.iter().position(|bus| bus.name == *name);
        let numbers = recording.buses.iter().map(number).collect();
        let (bytes, first, known) = (0, true, BTreeSet::new());
        let mut reader = Self {
            recording,
            plan,
            place,
            numbers,
            sender,
            batch: Batch::default(),
            bytes,
            first,
            known,
        };
        reader.batch = reader.empty(place.lap);
        reader
    }

    fn empty(&self, lap: u64) -> Batch {
        let items = Vec::with_capacity(BATCH_ITEMS);
        let omitted = vec![Omitted::default(); self.plan.buses.len()];
        Batch { items, lap, omitted, damage: Vec::new() }
    }

    fn run(mut self) {
        let (mut lap, mut from, mut media) = (self.place.lap, self.place.from, self.place.media);
        while self.plan.laps.is_none_or(|laps| lap < laps) {
            let before = self.batch.items.len();
            let Ok(last) = self.lap(from, media) else { return };
            if last.is_none()
                && before == self.batch.items.len()
                && from == *self.plan.range.start()
            {
                // A lap without anything to play would be followed by another at once, for ever.
                break;
            }
            media = last.unwrap_or(media).saturating_add(BETWEEN_LAPS);
            from = *self.plan.range.start();
            lap += 1;
            if self.hand_over(lap).is_err() {
                return;
            }
        }
        let _ = self.hand_over(lap);
    }

    /// Reads once to the end. Returns the media time of the last item.
    fn lap(&mut self, from: Timestamp, media: u64) -> Result<Option<u64>, Gone> {
        let wanted = |topic: &str| {
            let bus = topic.strip_prefix('/').and_then(|topic| topic.rsplit_once('/'));
            let Some((bus, "raw" | "gaps")) = bus else { return false };
            self.plan.buses.iter().any(|fed| fed.name == bus)
        };
        let recording = self.recording;
        let mut entries = recording.entries(from..=*self.plan.range.end(), wanted);
        let mut before: Option<(Timestamp, u64)> = None;
        let mut passed = 0;
        for entry in entries.by_ref() {
            let Entry::Frame(bus, mut frame) = entry.value else { continue };
            let Some(number) = self.numbers.get(bus).copied().flatten() else { continue };
            if let Err(why) = self.plan.buses[number].selection.take(&mut frame) {
                self.batch.omitted[number].add(why, 1);
                passed += 1;
                // Now and then, to notice that nobody wants to know any more.
                if passed % MOST_PASSED == 0 {
                    self.hand_over(self.batch.lap)?;
                }
                continue;
            }
            let at = match before {
                None => media,
                Some((time, at)) => {
                    let pause = entry.time.since(time);
                    at.saturating_add(self.plan.max_gap.map_or(pause, |most| pause.min(most)))
                }
            };
            before = Some((entry.time, at));
            self.bytes += if let Frame::Serial(bytes) = &frame { bytes.data.len() } else { 0 };
            self.batch.items.push(Item { media: at, time: entry.time, bus: number, frame });
            let full = if self.first { FIRST_ITEMS } else { BATCH_ITEMS };
            if self.batch.items.len() >= full || self.bytes >= BATCH_BYTES {
                self.hand_over(self.batch.lap)?;
            }
        }
        let damage = entries.damage().to_vec();
        for sentence in damage {
            if self.known.insert(sentence.clone()) {
                self.batch.damage.push(sentence);
            }
        }
        Ok(before.map(|(_, at)| at))
    }

    /// Gives what was read to the player, waiting until it has room.
    fn hand_over(&mut self, lap: u64) -> Result<(), Gone> {
        let next = self.empty(lap);
        (self.bytes, self.first) = (0, false);
        self.sender.send(std::mem::replace(&mut self.batch, next)).map_err(|_| Gone)
    }
}
