//! The steady clock, and waiting for it, and for descriptors at once.

use std::io;

use nix::errno::Errno;
use nix::poll::{PollFd, ppoll};
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};

/// Nanoseconds of `CLOCK_MONOTONIC`: since boot, without suspend; setting the wall clock does not
/// touch it.
pub fn steady_nanos() -> u64 {
    clock_gettime(ClockId::CLOCK_MONOTONIC).map_or(0, |time| {
        let seconds = u64::try_from(time.tv_sec()).unwrap_or(0);
        seconds.saturating_mul(1_000_000_000) + u64::try_from(time.tv_nsec()).unwrap_or(0)
    })
}

/// Lets the kernel wake this thread at the moment asked for, not up to 50 µs later so that it can
/// wake others together with it (`PR_SET_TIMERSLACK`). Needs no privilege.
///
/// # Errors
/// Where a sandbox forbids it.
pub fn least_timer_slack() -> io::Result<()> {
    Ok(nix::sys::prctl::set_timerslack(1)?)
}

/// Waits until the steady clock shows `until`, for nothing else: cheaper than [`wait`], and the
/// kernel does not round the time up (poll(2) is woken up to a thousandth of its time-out late,
/// `select_estimate_accuracy` in `fs/select.c`). Returns early where a signal is handled.
pub fn sleep_until(until: u64) {
    let seconds = i64::try_from(until / 1_000_000_000).unwrap_or(i64::MAX);
    let until = TimeSpec::new(seconds as _, (until % 1_000_000_000) as _);
    // Its errors are a handled signal and a clock that does not exist.
    let _ = clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &until);
}

/// Waits until one of `descriptors` is ready or the steady clock shows `until` (for ever without).
/// Returns how many are ready; 0 also when a signal came.
///
/// # Errors
/// `ENOMEM`.
pub fn wait(descriptors: &mut [PollFd<'_>], until: Option<u64>) -> io::Result<usize> {
    let timeout = until.map(|until| {
        let left = until.saturating_sub(steady_nanos());
        let seconds = i64::try_from(left / 1_000_000_000).unwrap_or(i64::MAX);
        TimeSpec::new(seconds as _, (left % 1_000_000_000) as _)
    });
    match ppoll(descriptors, timeout, None) {
        Ok(ready) => Ok(usize::try_from(ready).unwrap_or(0)),
        Err(Errno::EINTR) => Ok(0),
        Err(error) => Err(error.into()),
    }
}
