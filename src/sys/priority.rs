//! How much of the processor a thread gets.

/// Lets everything else go first (nice 19), for the calling thread only: on Linux a nice value
/// belongs to a thread (setpriority(2), "C library/kernel differences").
pub fn yield_to_others() {
    // SAFETY: takes three numbers; 0 stands for the calling thread. A failure changes nothing.
    unsafe {
        libc::setpriority(libc::PRIO_PROCESS, 0, 19);
    }
}
