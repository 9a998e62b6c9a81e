//! Ctrl-C and SIGTERM: the first one asks the run to write a checkpoint and stop, the second one ends it at once.

use std::sync::atomic::{AtomicBool, Ordering};

/// The exit code of a run that was stopped by a signal, 128 + SIGINT.
pub const EXIT_CODE: u8 = 130;

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// Listens for the signals from now on.
///
/// # Errors
/// When another handler is installed already.
pub fn install() -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(|| {
        if REQUESTED.swap(true, Ordering::SeqCst) {
            eprintln!("\nstopped at once; the last checkpoint is whole");
            std::process::exit(i32::from(EXIT_CODE));
        }
        eprintln!("\nstopping after this step with a checkpoint (once more stops at once)");
    })
}

/// Whether a signal has arrived.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::SeqCst)
}
