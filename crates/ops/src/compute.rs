//! Which number format convolutions compute in: half precision where a device gains by it.
//!
//! Parameters, normalisation of filters and maps, global means, warps, losses, optimiser and averages stay in single precision;
//! only what enters a convolution is rounded, and its result comes back in single precision. The gradient is rounded on the
//! same way back, before the convolution's backward passes, and reaches the parameters in single precision. Where there are
//! [kernels](crate::kernel), they compute with the rounded numbers and sum up in single precision, as GPUs multiply halves.
//! The transposed convolutions that enlarge flows and features in the published PWC layout (`flow::pwc`) aren't rounded: they
//! stay in single precision.

use std::cell::Cell;

use crate::setting::within;
use burn::tensor::{Device, FloatDType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A format of the numbers that convolutions read and write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Compute {
    /// Single precision.
    #[default]
    F32,
    /// Half precision: 11 bits, up to 65,504. Small gradients vanish in it unless the loss is scaled up.
    F16,
    /// The range of single precision with 8 bits.
    Bf16,
}

impl Compute {
    /// All formats.
    pub const ALL: [Self; 3] = [Self::F32, Self::F16, Self::Bf16];

    /// As the config names it.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
        }
    }

    /// The rounded format; `None` for single precision.
    pub(crate) fn rounded(self) -> Option<FloatDType> {
        match self {
            Self::F32 => None,
            Self::F16 => Some(FloatDType::F16),
            Self::Bf16 => Some(FloatDType::BF16),
        }
    }

    /// Whether a device can compute in this format.
    pub fn runs_on(self, device: &Device) -> bool {
        self.rounded().is_none_or(|format| device.supports_dtype(format))
    }

    /// Runs `forward` with its convolutions in this format, backward passes of what it returns included.
    pub fn within<T>(self, forward: impl FnOnce() -> T) -> T {
        within(&CURRENT, self, forward)
    }

    /// The format that the calling thread computes in.
    pub(crate) fn current() -> Self {
        CURRENT.get()
    }
}

thread_local! {
    // A net's layers don't know how they are trained, so the format isn't theirs (PyTorch's `autocast` works the same way).
    static CURRENT: Cell<Compute> = const { Cell::new(Compute::F32) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_holds_inside_alone_and_survives_a_panic() {
        assert_eq!(Compute::current(), Compute::F32);
        let inner = Compute::Bf16.within(|| (Compute::current(), Compute::F16.within(Compute::current), Compute::current()));
        assert_eq!(inner, (Compute::Bf16, Compute::F16, Compute::Bf16));
        let panicked = std::panic::catch_unwind(|| Compute::F16.within(|| std::panic::panic_any(())));
        assert!(panicked.is_err());
        assert_eq!(Compute::current(), Compute::F32);
    }

    #[test]
    fn a_format_is_named_as_in_the_config() {
        for format in Compute::ALL {
            assert_eq!(serde_json::to_value(format).unwrap(), format.name());
        }
    }

    #[test]
    fn the_cpu_computes_in_all_formats() {
        assert!(Compute::ALL.into_iter().all(|format| format.runs_on(&Device::flex())));
    }
}
