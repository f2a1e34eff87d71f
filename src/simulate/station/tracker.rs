//! The solar tracker: two linear actuators that turn the panels after the sun, bit by bit.

use super::Event;
use super::sun::Position;
use crate::simulate::STEP_SECONDS;

/// Stroke of both actuators, mm (HMI CAN protocol, section 5.1, TRACKER_0: 0-900 mm).
pub const STROKE: f64 = 900.0;
/// Angles at both ends of the horizontal actuator, degrees (the same section).
const HORIZONTAL: (f64, f64) = (54.51, 305.20);
/// Angles at both ends of the vertical actuator, degrees.
const VERTICAL: (f64, f64) = (0.0, 90.0);
/// How fast an actuator pushes, mm/s.
const SPEED: f64 = 4.0;
/// The panels follow when the sun is this far off, degrees.
const TOLERANCE: f64 = 4.0;

/// Both axes and the supply of the actuators.
#[derive(Clone, Debug)]
pub struct Tracker {
    /// Position of the vertical actuator, mm, 0..=900.
    pub vertical: f64,
    /// Position of the horizontal actuator, mm, 0..=900.
    pub horizontal: f64,
    /// The last position saved, (vertical, horizontal), mm.
    pub saved: (f64, f64),
    /// True while the actuators have power.
    pub moving: bool,
    /// Seconds of work since the controller was started.
    pub worked: f64,
    target: (f64, f64),
}

impl Tracker {
    /// Panels that stand as they have to for the sun at `sun`.
    pub fn new(sun: Position) -> Self {
        let target = wanted(sun);
        let (vertical, horizontal) = target;
        Self { vertical, horizontal, saved: target, moving: false, worked: 5_230.0, target }
    }

    /// One step. Events: the supply of the actuators.
    pub fn step(&mut self, sun: Position, events: &mut Vec<Event>) {
        if !self.moving && self.off_by(sun) > TOLERANCE {
            self.target = wanted(sun);
            self.moving = true;
            events.push(Event::ActuatorsOn);
        }
        if self.moving {
            self.worked += STEP_SECONDS;
            self.vertical = towards(self.vertical, self.target.0);
            self.horizontal = towards(self.horizontal, self.target.1);
            if (self.vertical, self.horizontal) == self.target {
                self.moving = false;
                self.saved = self.target;
                events.push(Event::ActuatorsOff);
            }
        }
    }

    /// Share of the sun's beam that the panels catch, 0..=1: the cosine of the angle between both.
    pub fn aim(&self, sun: Position) -> f64 {
        let (tilt, turn) = self.angles();
        let (tilt, height) = (tilt.to_radians(), sun.elevation.to_radians());
        let turned = (sun.azimuth - turn).to_radians();
        (tilt.sin() * height.sin() + tilt.cos() * height.cos() * turned.cos()).max(0.0)
    }

    /// Elevation and azimuth the panels face, degrees.
    fn angles(&self) -> (f64, f64) {
        let at = |(from, to): (f64, f64), position: f64| from + (to - from) * position / STROKE;
        (at(VERTICAL, self.vertical), at(HORIZONTAL, self.horizontal))
    }

    /// The larger of both axes' errors, degrees, within what the actuators can reach.
    fn off_by(&self, sun: Position) -> f64 {
        let (vertical, horizontal) = wanted(sun);
        let degrees = |(from, to): (f64, f64), mm: f64| mm.abs() / STROKE * (to - from);
        degrees(VERTICAL, vertical - self.vertical)
            .max(degrees(HORIZONTAL, horizontal - self.horizontal))
    }
}

/// Actuator positions (vertical, horizontal) for the sun at `sun`, whole millimetres; at night the
/// panels wait in the east, steep, so that snow and dew run off.
fn wanted(sun: Position) -> (f64, f64) {
    let sun = if sun.elevation > 0.0 { sun } else { Position { elevation: 20.0, azimuth: 90.0 } };
    let mm = |angle: f64, (from, to): (f64, f64)| {
        ((angle - from) / (to - from) * STROKE).clamp(0.0, STROKE).round()
    };
    (mm(sun.elevation, VERTICAL), mm(sun.azimuth, HORIZONTAL))
}

fn towards(position: f64, target: f64) -> f64 {
    let most = SPEED * STEP_SECONDS;
    position + (target - position).clamp(-most, most)
}
