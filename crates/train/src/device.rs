//! `--device`: which of the back ends that were built in the nets run on.

use burn::tensor::Device;

/// A device that can't be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// No back end of that name exists.
    #[error("unknown device `{found}`: expected one of {}", NAMES.join(", "))]
    Unknown {
        /// What was asked for.
        found: String,
    },
    /// The back end exists but this binary was built without it.
    #[error(
        "the device `{found}` is not built into this binary (built in: {}): build it with `cargo run -p train --features {found} -- …`, or use `--device cpu`",
        built_in().join(", ")
    )]
    NotBuiltIn {
        /// What was asked for.
        found: String,
    },
    /// The back end was built in but could not be started.
    #[error("the device `{found}` could not be started: {reason}; is there a driver and a card? `--device cpu` always works")]
    Absent {
        /// What was asked for.
        found: String,
        /// What the back end said.
        reason: String,
    },
}

/// The names that `--device` knows.
pub const NAMES: [&str; 4] = ["cpu", "vulkan", "wgpu", "cuda"];

/// The names this binary can serve.
pub fn built_in() -> Vec<&'static str> {
    let present = [true, cfg!(feature = "vulkan"), cfg!(feature = "wgpu"), cfg!(feature = "cuda")];
    NAMES.into_iter().zip(present).filter_map(|(name, present)| present.then_some(name)).collect()
}

/// Opens a device and proves with one small computation that it is there.
///
/// # Errors
/// An unknown name, a back end that isn't built in, or one that can't be started.
pub fn open(name: &str) -> Result<Device, DeviceError> {
    if !NAMES.contains(&name) {
        return Err(DeviceError::Unknown { found: name.into() });
    }
    if !built_in().contains(&name) {
        return Err(DeviceError::NotBuiltIn { found: name.into() });
    }
    // GPU back ends panic where they find no card; that is user data here, not a bug.
    std::panic::catch_unwind(|| {
        let device = back_end(name);
        let sum: f32 = burn::tensor::Tensor::<1>::ones([4], &device).sum().into_scalar();
        assert!(sum == 4.0, "it computes 1 + 1 + 1 + 1 = {sum}");
        device
    })
    .map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned().or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
        DeviceError::Absent { found: name.into(), reason: text.unwrap_or_else(|| "no reason given".into()) }
    })
}

fn back_end(name: &str) -> Device {
    match name {
        #[cfg(feature = "vulkan")]
        "vulkan" => Device::vulkan(burn::tensor::DeviceKind::DefaultDevice),
        #[cfg(feature = "wgpu")]
        "wgpu" => Device::wgpu(burn::tensor::DeviceKind::DefaultDevice),
        #[cfg(feature = "cuda")]
        "cuda" => Device::cuda(0),
        _ => Device::flex(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cpu_is_always_there() {
        assert!(open("cpu").is_ok());
    }

    #[test]
    fn an_unknown_device_names_the_known_ones() {
        let text = open("tpu").unwrap_err().to_string();
        assert!(text.contains("tpu") && text.contains("cpu, vulkan, wgpu, cuda"), "{text}");
    }

    #[cfg(not(feature = "cuda"))]
    #[test]
    fn a_device_that_is_not_built_in_says_how_to_build_it() {
        let text = open("cuda").unwrap_err().to_string();
        assert!(text.contains("--features cuda") && text.contains("--device cpu"), "{text}");
    }
}
