//! `--device`: which of the back ends that were built in the nets run on, and which of its cards (`cuda:1`).
//!
//! One run may use several cards of a kind, `--device cuda:0,cuda:1`: they share the batches of a step (see [`crate::run_loop`]),
//! so every stage needs as many in `optimisation.accumulate`. `train sweep` gives several cards to several runs instead.

use burn::tensor::Device;
use ops::compute::Compute;

/// A device that can't be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// No back end of that name exists.
    #[error("unknown device `{found}`: expected one of {}", NAMES.join(", "))]
    Unknown {
        /// What was asked for.
        found: String,
    },
    /// The CPU as one of several devices.
    #[error(
        "`--device {found}`: the CPU is one device, which uses all cores by itself (`RAYON_NUM_THREADS` limits them): expected `cpu` alone, or cards alone"
    )]
    Cpus {
        /// What was asked for.
        found: String,
    },
    /// Devices of several kinds for one run.
    #[error(
        "`--device {found}` names devices of several kinds: expected one kind, for example `cuda:0,cuda:1`, because kinds round differently and the run could not be repeated"
    )]
    Mixed {
        /// What was asked for.
        found: String,
    },
    /// One of several devices without a number of its own.
    #[error("`--device {found}`: of several cards each is named once and by its number, for example `cuda:0,cuda:1`")]
    Numbers {
        /// What was asked for.
        found: String,
    },
    /// More devices than a step of some stage has batches.
    #[error(
        "`--device {found}` names {devices} devices, which share the batches of a step, but a step of {stage} has {batches}: set `{stage}.optimisation.accumulate` to {devices} or more (with a smaller `{stage}.batch` for as many exemplars per step); `train sweep FILE --device {found} --jobs {devices}` gives each run a device of its own"
    )]
    Batches {
        /// What was asked for.
        found: String,
        /// Devices.
        devices: usize,
        /// Stage of the run.
        stage: &'static str,
        /// Batches in one of its steps.
        batches: usize,
    },
    /// Several devices for the tasks of an engine.
    #[error(
        "`--device {found}` names several devices, and an engine gives its tasks one each: name the kind alone, for example `--device cuda`, and let the engine choose the card"
    )]
    Tasks {
        /// What was asked for.
        found: String,
    },
    /// A back end that is one device, or a number that is none.
    #[error("the device `{found}` is not one of {kind}'s: expected {}", expected(kind))]
    Number {
        /// What was asked for.
        found: String,
        /// The back end.
        kind: String,
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
    /// The device can't compute in the config's format.
    #[error(
        "the device `{found}` can't compute in the format `{}` of `run.compute`: set `run.compute` to {}", format.name(),
        others.iter().map(|format| format!("`{}`", format.name())).collect::<Vec<_>>().join(" or ")
    )]
    Format {
        /// The device.
        found: String,
        /// The format.
        format: Compute,
        /// Formats that it can compute in.
        others: Vec<Compute>,
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

/// Whether a device computes in a format.
///
/// # Errors
/// It doesn't.
pub fn check_format(device: &Device, name: &str, compute: Compute) -> Result<(), DeviceError> {
    choose_format(name, compute, |format| format.runs_on(device))
}

fn choose_format(name: &str, format: Compute, runs: impl Fn(Compute) -> bool) -> Result<(), DeviceError> {
    if runs(format) {
        return Ok(());
    }
    let others = Compute::ALL.into_iter().filter(|other| runs(*other)).collect();
    Err(DeviceError::Format { found: name.into(), format, others })
}

/// The names that `--device` knows.
pub const NAMES: [&str; 4] = ["cpu", "vulkan", "wgpu", "cuda"];

/// The names this binary can serve.
pub fn built_in() -> Vec<&'static str> {
    let present = [true, cfg!(feature = "vulkan"), cfg!(feature = "wgpu"), cfg!(feature = "cuda")];
    NAMES.into_iter().zip(present).filter_map(|(name, present)| present.then_some(name)).collect()
}

fn expected(kind: &str) -> String {
    match kind {
        "cpu" => "`cpu`, which uses all cores by itself (`RAYON_NUM_THREADS` limits them)".into(),
        kind => format!("`{kind}` or a card by its number, `{kind}:0`, `{kind}:1` …"),
    }
}

/// The back end in a device's name, or in the name of the first of several.
pub fn kind(name: &str) -> &str {
    name.split([':', ',']).next().unwrap_or(name)
}

/// The devices of a list, `cuda:0,cuda:1`, each once.
///
/// # Errors
/// A name that no back end has, or a number that can't be one of its devices.
pub fn list(names: &str) -> Result<Vec<String>, DeviceError> {
    let mut devices: Vec<String> = Vec::new();
    for name in names.split(',').map(str::trim) {
        parse(name)?;
        if !devices.iter().any(|known| known == name) {
            devices.push(name.into());
        }
    }
    Ok(devices)
}

/// The back end that a device belongs to, and the device's number when one is given.
fn parse(name: &str) -> Result<(&str, Option<usize>), DeviceError> {
    let (kind, number) = name.split_once(':').map_or((name, None), |(kind, number)| (kind, Some(number)));
    if !NAMES.contains(&kind) {
        return Err(DeviceError::Unknown { found: name.into() });
    }
    let wrong = || DeviceError::Number { found: name.into(), kind: kind.into() };
    match number {
        None => Ok((kind, None)),
        Some(_) if kind == "cpu" => Err(wrong()),
        Some(number) => Ok((kind, Some(number.parse().map_err(|_| wrong())?))),
    }
}

/// The devices of one run: one, or several cards of a kind.
///
/// # Errors
/// A name that no back end has, or devices that can't train one net together.
pub fn of_one_run(names: &str) -> Result<Vec<String>, DeviceError> {
    let found = || names.to_string();
    let devices: Vec<&str> = names.split(',').map(str::trim).collect();
    let parsed = devices.iter().map(|name| parse(name)).collect::<Result<Vec<_>, _>>()?;
    if devices.len() > 1 {
        if parsed.iter().any(|(kind, _)| *kind == "cpu") {
            return Err(DeviceError::Cpus { found: found() });
        }
        if parsed.iter().any(|(kind, _)| *kind != parsed[0].0) {
            return Err(DeviceError::Mixed { found: found() });
        }
        if parsed
            .iter()
            .enumerate()
            .any(|(i, (_, number))| number.is_none() || parsed[..i].iter().any(|(_, other)| other == number))
        {
            return Err(DeviceError::Numbers { found: found() });
        }
    }
    Ok(devices.into_iter().map(String::from).collect())
}

/// Finds a stage whose steps have fewer batches than there are devices; `stages` are names with the batches of their steps.
///
/// # Errors
/// The first such stage.
pub fn check_batches(devices: &[String], stages: &[(&'static str, usize)]) -> Result<(), DeviceError> {
    match stages.iter().find(|(_, batches)| *batches < devices.len()) {
        Some(&(stage, batches)) => {
            Err(DeviceError::Batches { found: devices.join(","), devices: devices.len(), stage, batches })
        }
        None => Ok(()),
    }
}

/// Opens a device and proves with one small computation that it is there.
///
/// # Errors
/// An unknown name, a back end that isn't built in, or one that can't be started.
pub fn open(name: &str) -> Result<Device, DeviceError> {
    let (kind, number) = parse(name)?;
    if !built_in().contains(&kind) {
        return Err(DeviceError::NotBuiltIn { found: kind.into() });
    }
    // GPU back ends panic where they find no card; that is user data here, not a bug.
    std::panic::catch_unwind(|| {
        let device = back_end(kind, number);
        let sum: f32 = burn::tensor::Tensor::<1>::ones([4], &device).sum().into_scalar();
        assert!(sum == 4.0, "it computes 1 + 1 + 1 + 1 = {sum}");
        device
    })
    .map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned().or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
        DeviceError::Absent { found: name.into(), reason: text.unwrap_or_else(|| "no reason given".into()) }
    })
}

#[cfg_attr(not(any(feature = "vulkan", feature = "wgpu", feature = "cuda")), expect(unused_variables))]
fn back_end(kind: &str, number: Option<usize>) -> Device {
    #[cfg(any(feature = "vulkan", feature = "wgpu"))]
    let card = number.map_or(burn::tensor::DeviceKind::DefaultDevice, burn::tensor::DeviceKind::DiscreteGpu);
    match kind {
        #[cfg(feature = "vulkan")]
        "vulkan" => Device::vulkan(card),
        #[cfg(feature = "wgpu")]
        "wgpu" => Device::wgpu(card),
        #[cfg(feature = "cuda")]
        "cuda" => Device::cuda(number.unwrap_or(0)),
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

    #[test]
    fn several_cards_of_a_kind_train_one_net_and_nothing_else_does() {
        assert_eq!(of_one_run("cuda:1, cuda:0").unwrap(), ["cuda:1", "cuda:0"]);
        assert_eq!(of_one_run("cpu").unwrap(), ["cpu"]);
        for (names, reason) in [
            ("cpu,cpu", "uses all cores by itself"),
            ("cuda:0,cpu", "cards alone"),
            ("cuda:0,vulkan:0", "several kinds"),
            ("cuda:0,cuda", "by its number"),
            ("cuda:0,cuda:1,cuda:0", "each is named once"),
            ("cuda:0,tpu", "unknown device `tpu`"),
            ("cuda:0,", "unknown device ``"),
        ] {
            let text = of_one_run(names).unwrap_err().to_string();
            assert!(text.contains(reason), "{names}: {text}");
        }
    }

    #[test]
    fn a_step_needs_a_batch_for_every_device() {
        let devices = of_one_run("cuda:0,cuda:1").unwrap();
        assert_eq!(check_batches(&devices, &[("adjacent", 2), ("svbrdf", 5)]), Ok(()));
        let text = check_batches(&devices, &[("adjacent", 2), ("svbrdf", 1)]).unwrap_err().to_string();
        assert!(text.contains("`svbrdf.optimisation.accumulate` to 2 or more"), "{text}");
        assert!(text.contains("train sweep FILE --device cuda:0,cuda:1 --jobs 2"), "{text}");
    }

    #[test]
    fn a_format_that_a_device_lacks_is_named_as_in_the_config_with_those_it_has() {
        let text =
            |runs: &[Compute]| choose_format("vulkan", Compute::Bf16, |format| runs.contains(&format)).unwrap_err().to_string();
        let both = text(&[Compute::F32, Compute::F16]);
        assert!(both.contains("`vulkan`") && both.contains("`bf16` of `run.compute`"), "{both}");
        assert!(both.ends_with("set `run.compute` to `f32` or `f16`"), "{both}");
        assert!(text(&[Compute::F32]).ends_with("set `run.compute` to `f32`"));
        assert_eq!(check_format(&Device::flex(), "cpu", Compute::Bf16), Ok(()));
    }

    #[test]
    fn a_list_names_each_device_once() {
        assert_eq!(list("cuda:1, cuda:0,cuda:1").unwrap(), ["cuda:1", "cuda:0"]);
        assert_eq!(list("cpu,cpu").unwrap(), ["cpu"]);
        assert!(matches!(list("cuda:0,tpu"), Err(DeviceError::Unknown { .. })));
    }

    #[test]
    fn the_cpu_has_no_numbers_and_cards_have_nothing_else() {
        assert!(list("cpu:1").unwrap_err().to_string().contains("all cores"));
        assert!(list("cuda:first").unwrap_err().to_string().contains("`cuda:1`"));
    }

    #[cfg(not(feature = "cuda"))]
    #[test]
    fn a_device_that_is_not_built_in_says_how_to_build_it() {
        let text = open("cuda").unwrap_err().to_string();
        assert!(text.contains("--features cuda") && text.contains("--device cpu"), "{text}");
    }
}
