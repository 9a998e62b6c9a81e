//! The published net's own names: from a checkpoint of Sun et al.'s PyTorch release to this net's weights.
//!
//! The table stands at [`PwcConfig::published`].

use std::collections::BTreeMap;

use ops::weights::{StoredTensor, Tensors};

use super::{PwcConfig, PwcConfigError};

/// What checkpoints of nets that were trained on several GPUs put before every name.
const PARALLEL: &str = "module.";
/// A layer of the release whose output nothing reads.
const UNREAD: &str = "deconv2.";
/// Unexpected names that an error shows.
const SHOWN: usize = 4;

/// Tensors that aren't the published net's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReleaseError {
    /// A layer is missing.
    #[error(
        "there is no `{tensor}`, which PWC-Net as published has (PWC-DC-Net of NVlabs/PWC-Net, names conv1a.0.weight to dc_conv7.bias); there is {found}"
    )]
    Missing {
        /// The tensor's published name.
        tensor: String,
        /// What there is.
        found: String,
    },
    /// The tensors have this program's own names.
    #[error(
        "the tensors have the names of this program already: nothing is to be imported, give the file as `flow.init` or its folder as `--weights`"
    )]
    Ours,
    /// Tensors of another net.
    #[error("there is {found}, which PWC-Net as published hasn't")]
    Unexpected {
        /// What there is.
        found: String,
    },
    /// A tensor whose shape can't be this layer's.
    #[error("`{tensor}` has shape {found:?}, expected {expected}")]
    Shape {
        /// The tensor's published name.
        tensor: String,
        /// Its shape.
        found: Vec<usize>,
        /// What it may be.
        expected: &'static str,
    },
    /// Shapes of a net that can't be built.
    #[error(transparent)]
    Config(#[from] PwcConfigError),
}

/// Architecture and weights of this net from the release's tensors, whatever its widths: read from their shapes.
///
/// # Errors
/// If a layer is missing, another net's is there, or the shapes are no net.
///
/// # Source
/// Sun et al. 2018, their PyTorch release: `PWCDCNet` and its first version, `PWCDCNet_old`, without `aa` convolutions.
pub fn from_release(tensors: Tensors) -> Result<(PwcConfig, Tensors), ReleaseError> {
    if tensors.keys().any(|name| name.starts_with("pyramid.levels.")) {
        return Err(ReleaseError::Ours);
    }
    let plain = |name: &str| name.strip_prefix(PARALLEL).unwrap_or(name).to_string();
    let mut tensors: Tensors = tensors.into_iter().map(|(name, tensor)| (plain(&name), tensor)).collect();
    tensors.retain(|name, _| !name.starts_with(UNREAD));

    let config = architecture(&tensors)?;
    let mut renamed = Tensors::new();
    for (theirs, ours) in layers(&config) {
        for part in ["weight", "bias"] {
            let name = format!("{theirs}.{part}");
            let Some(tensor) = tensors.remove(&name) else { return Err(missing(name, &tensors)) };
            renamed.insert(format!("{ours}.{part}"), tensor);
        }
    }
    if !tensors.is_empty() {
        return Err(ReleaseError::Unexpected { found: some_names(&tensors) });
    }
    if let Some(filters) = renamed.get_mut("pyramid.levels.0.convs.0.weight") {
        from_bgr(filters)?;
    }
    Ok((config, renamed))
}

/// The architecture that the shapes speak of.
fn architecture(tensors: &Tensors) -> Result<PwcConfig, ReleaseError> {
    let shape = |name: String| match tensors.get(&name) {
        Some(tensor) => match <[usize; 4]>::try_from(tensor.shape.as_slice()) {
            Ok(shape) => Ok(shape),
            Err(_) => {
                let found = tensor.shape.clone();
                Err(ReleaseError::Shape { tensor: name, found, expected: "four axes: outputs, inputs, height, width" })
            }
        },
        None => Err(missing(name, tensors)),
    };
    let widths = |name: &dyn Fn(usize) -> String, from: usize| {
        let present = (from..).map(name).take_while(|name| tensors.contains_key(name));
        present.map(|name| shape(name).map(|[outputs, ..]| outputs)).collect::<Result<Vec<_>, _>>()
    };
    let channels = widths(&|level| format!("conv{level}a.0.weight"), 1)?;
    let coarsest = channels.len();
    if coarsest == 0 {
        return Err(missing("conv1a.0.weight".into(), tensors));
    }
    let [_, displacements, ..] = shape(format!("conv{coarsest}_0.0.weight"))?;
    let side = displacements.isqrt();
    if side * side != displacements || side % 2 == 0 {
        let tensor = format!("conv{coarsest}_0.0.weight");
        let found = tensors[&tensor].shape.clone();
        return Err(ReleaseError::Shape { tensor, found, expected: "(2·radius + 1)² inputs, 81 in the release" });
    }
    let config = PwcConfig {
        convs_per_level: if tensors.contains_key("conv1aa.0.weight") { 3 } else { 2 },
        estimator: widths(&|conv| format!("conv{coarsest}_{conv}.0.weight"), 0)?,
        context: widths(&|conv| format!("dc_conv{conv}.0.weight"), 1)?,
        radius: side / 2,
        channels,
        ..PwcConfig::published()
    };
    config.validate()?;
    Ok(config)
}

/// Every layer's published name and its own.
fn layers(config: &PwcConfig) -> Vec<(String, String)> {
    let coarsest = config.channels.len();
    let mut layers = Vec::new();
    for level in 1..=coarsest {
        let parts: &[&str] = match (config.convs_per_level, level == coarsest) {
            (2, _) => &["a", "b"],
            // At the coarsest level the release swaps the first two names.
            (_, true) => &["aa", "a", "b"],
            (_, false) => &["a", "aa", "b"],
        };
        let name = |(i, part)| (format!("conv{level}{part}.0"), format!("pyramid.levels.{}.convs.{i}", level - 1));
        layers.extend(parts.iter().enumerate().map(name));
    }
    for (index, level) in (2..=coarsest).rev().enumerate() {
        let convs = 0..config.estimator.len();
        layers.extend(convs.map(|k| (format!("conv{level}_{k}.0"), format!("estimators.{index}.convs.{k}"))));
        layers.push((format!("predict_flow{level}"), format!("estimators.{index}.predict")));
        if level > 2 {
            layers.push((format!("deconv{level}"), format!("upsamplers.{index}.flow")));
            layers.push((format!("upfeat{level}"), format!("upsamplers.{index}.features")));
        }
    }
    let dilated = config.context.len();
    layers.extend((0..dilated).map(|k| (format!("dc_conv{}.0", k + 1), format!("context.convs.{k}"))));
    layers.push((format!("dc_conv{}", dilated + 1), "context.predict".into()));
    layers
}

/// Filters `[out, 3, h, w]` for RGB from those for BGR.
fn from_bgr(filters: &mut StoredTensor) -> Result<(), ReleaseError> {
    let (taps, colours) = match filters.shape.as_slice() {
        [_, 3, height, width] => (height * width, 3),
        _ => {
            let (tensor, found) = ("conv1a.0.weight".into(), filters.shape.clone());
            return Err(ReleaseError::Shape { tensor, found, expected: "three inputs: blue, green, red" });
        }
    };
    for filter in filters.values.chunks_exact_mut(colours * taps) {
        let (blue, rest) = filter.split_at_mut(taps);
        blue.swap_with_slice(&mut rest[taps..]);
    }
    Ok(())
}

fn missing(tensor: String, tensors: &Tensors) -> ReleaseError {
    ReleaseError::Missing { tensor, found: some_names(tensors) }
}

/// A few names with their shapes, for errors.
fn some_names(tensors: &BTreeMap<String, StoredTensor>) -> String {
    let shown: Vec<_> = tensors.iter().take(SHOWN).map(|(name, t)| format!("`{name}` {:?}", t.shape)).collect();
    match (tensors.len(), shown.join(", ")) {
        (0, _) => "nothing else".into(),
        (count, shown) if count > SHOWN => format!("{shown} and {} more", count - SHOWN),
        (_, shown) => shown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ops::weights::{fill, tensors_of};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn tiny() -> PwcConfig {
        PwcConfig { channels: vec![4, 6, 8], estimator: vec![8, 6], context: vec![6, 4], ..PwcConfig::published() }
    }

    /// A net's weights under the release's names.
    fn released(config: &PwcConfig) -> Tensors {
        let net = config.init(&burn::tensor::Device::flex(), &mut ChaCha8Rng::seed_from_u64(5));
        let ours = tensors_of(&net);
        let parts =
            |(theirs, own): (String, String)| ["weight", "bias"].map(|p| (format!("{theirs}.{p}"), format!("{own}.{p}")));
        layers(config).into_iter().flat_map(parts).map(|(theirs, own)| (theirs, ours[&own].clone())).collect()
    }

    #[test]
    fn shapes_tell_the_architecture_and_every_weight_finds_its_place() {
        for config in [tiny(), PwcConfig { convs_per_level: 2, radius: 2, ..tiny() }] {
            let mut tensors = released(&config);
            tensors.insert("deconv2.weight".into(), StoredTensor { shape: vec![2], values: vec![0.0; 2] });
            let tensors = tensors.into_iter().map(|(name, t)| (format!("module.{name}"), t)).collect();
            let (found, weights) = from_release(tensors).unwrap();
            assert_eq!(found, config);
            let net = config.init(&burn::tensor::Device::flex(), &mut ChaCha8Rng::seed_from_u64(9));
            fill(net, weights, std::path::Path::new("test")).unwrap();
        }
    }

    #[test]
    fn the_full_release_is_the_published_size() {
        assert_eq!(from_release(released(&PwcConfig::published())).unwrap().0, PwcConfig::published());
    }

    #[test]
    fn red_and_blue_change_places() {
        let tensors = released(&tiny());
        let before = tensors["conv1a.0.weight"].values.clone();
        let after = &from_release(tensors).unwrap().1["pyramid.levels.0.convs.0.weight"].values;
        for filter in 0..4 {
            let colour = |values: &[f32], c: usize| values[filter * 27 + c * 9..][..9].to_vec();
            for c in 0..3 {
                assert_eq!(colour(after, c), colour(&before, 2 - c));
            }
        }
    }

    #[test]
    fn other_nets_are_named() {
        let refused = |edit: &dyn Fn(&mut Tensors)| {
            let mut tensors = released(&tiny());
            edit(&mut tensors);
            from_release(tensors).unwrap_err().to_string()
        };
        let stored = |shape: &[usize]| StoredTensor { shape: shape.to_vec(), values: vec![0.0; shape.iter().product()] };
        let message = refused(&|t| t.clear());
        assert!(message.contains("`conv1a.0.weight`") && message.contains("nothing else"), "{message}");
        let message = refused(&|t| drop(t.remove("upfeat3.bias")));
        assert!(message.contains("`upfeat3.bias`"), "{message}");
        let message = refused(&|t| drop(t.insert("fc.weight".into(), stored(&[10, 4]))));
        assert!(message.contains("`fc.weight` [10, 4]"), "{message}");
        let message = refused(&|t| drop(t.insert("conv1a.0.weight".into(), stored(&[4, 5, 3, 3]))));
        assert!(message.contains("blue, green, red"), "{message}");
        let message = refused(&|t| drop(t.insert("conv3_0.0.weight".into(), stored(&[8, 80, 3, 3]))));
        assert!(message.contains("radius"), "{message}");
        let message = refused(&|t| drop(t.insert("conv2a.0.weight".into(), stored(&[2000, 4, 1, 1]))));
        assert!(message.contains("2000"), "{message}");
        let message = refused(&|t| drop(t.insert("conv2a.0.weight".into(), stored(&[6]))));
        assert!(message.contains("four axes"), "{message}");
        let message = refused(&|t| drop(t.insert("pyramid.levels.0.convs.0.weight".into(), stored(&[1]))));
        assert!(message.contains("flow.init"), "{message}");
    }
}
