//! Settings of a thread that hold while a function runs.

use std::cell::Cell;
use std::thread::LocalKey;

/// Runs `f` while `setting` has the value, and puts back what was there before, even when `f` panics.
pub(crate) fn within<S: Copy, T>(setting: &'static LocalKey<Cell<S>>, value: S, f: impl FnOnce() -> T) -> T {
    let _before = Restore { setting, before: setting.replace(value) };
    f()
}

struct Restore<S: Copy + 'static> {
    setting: &'static LocalKey<Cell<S>>,
    before: S,
}

impl<S: Copy> Drop for Restore<S> {
    fn drop(&mut self) {
        self.setting.set(self.before);
    }
}

#[cfg(test)]
mod tests {
    use crate::kernel::{available, without};
    use burn::tensor::{Device, Tensor};

    #[test]
    fn the_kernels_are_back_after_a_panic() {
        let run = || available(&Tensor::<1>::zeros([1], &Device::flex()));
        assert!(run() && !without(run));
        assert!(std::panic::catch_unwind(|| without(|| std::panic::panic_any(()))).is_err());
        assert!(run());
    }
}
