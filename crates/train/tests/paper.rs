//! `configs/paper.toml`, with all defaults resolved, beside the numbers of the paper, written down once more.

use std::collections::BTreeMap;

use train::config::Config;

/// What a run of the paper's method is made of. §: section of the paper; [S]: Sun et al. 2018; [D]: Deschaintre et al. 2019;
/// [code]: where the text is silent, the authors' released code.
const RECIPE: &str = r#"
[flow]
size = "paper"                                       # 5.03 M parameters: crates/flow/tests/twin.rs
init = "none"                                        # from the pre-training below (§5)

[chairs]                                             # §5: 50 epochs of FlyingChairs' 22,872 pairs
steps = 143000
batch = 8                                            # [S]
rendered_share = 0.0
pairs = { resolution = 256, shapes = [5, 20], noise_scale = 1.0 }
loss = { error = "euclidean", level_weights = [0.32, 0.08, 0.02, 0.01, 0.005], matching_weight = 0.0 }  # [S]
teaching.forcing = 0.0
optimisation = { learning_rate = 1e-4, schedule = "constant", warm_up = 0, weight_decay = 4e-4, clip = 0.0, accumulate = 1, ema = 0.0, adam = { beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8 } }

[adjacent]                                           # §5: neighbouring frames
steps = 1750000                                      # 50 epochs × 1,000 videos × 140 pairs / 4
batch = 4                                            # [code]
mixed_videos = 1000
pairs = { resolution = 256, crop = 0, augment = false }
loss = { error = "euclidean", level_weights = [0.32, 0.08, 0.02, 0.01, 0.005], matching_weight = 0.0 }
teaching.forcing = 0.0
optimisation = { learning_rate = 1e-4, schedule = "constant", warm_up = 0, weight_decay = 4e-4, clip = 0.0, accumulate = 1, ema = 0.0, adam = { beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8 } }

[adjacent.videos]                                    # §4
noise_scale = 1.0
path = { template = "spiral", line_share = 0.0, line_order = "scan", unit_length = "view", deviation_scale = 1.0, roll_deg = 0.0, frame_rate = 1.0, frames = 141 }
augment = { flip = 0.5, scale = [0.8, 1.25], roughness_floor = 0.1, perlin = 0.0, perlin_wavelength = [16, 64], perlin_masks = 100 }
light = { kind = "flow", ambient = [0, 0], environments = "" }

[distant]                                            # §5: pairs of all sizes, so one at a time
steps = 1000000                                      # 50 epochs × 1,000 videos × 20 guidance frames
batch = 1
mixed_videos = 1000
pairs = { resolution = 256, crop = 0, augment = false }
loss = { error = "euclidean", level_weights = [0.32, 0.08, 0.02, 0.01, 0.005], matching_weight = 0.0 }
teaching.forcing = 0.0
optimisation = { learning_rate = 1e-4, schedule = "constant", warm_up = 0, weight_decay = 4e-4, clip = 0.0, accumulate = 1, ema = 0.0, adam = { beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8 } }

[distant.videos]
noise_scale = 1.0
path = { template = "spiral", line_share = 0.0, line_order = "scan", unit_length = "view", deviation_scale = 1.0, roll_deg = 0.0, frame_rate = 1.0, frames = 141 }
augment = { flip = 0.5, scale = [0.8, 1.25], roughness_floor = 0.1, perlin = 0.0, perlin_wavelength = [16, 64], perlin_masks = 100 }
light = { kind = "flow", ambient = [0, 0], environments = "" }

[svbrdf]                                             # §6
steps = 2000000                                      # [code]
net = { width = 64, levels = 8, normalisation = "weight", filter_gain = 1.0, fusion = "features", pixel_features = "none", pooling = "max", dropout = 0.5, output = { start = "zero", gain = 0.02 } }  # gain: [code]
exemplars = { resolution = 256, key_frames = [4, 16], mixed_videos = 50, shuffle_colours = false }
loss = { kind = "paper", weights = { maps = 0.1, rendering = 1.0, top = 1.0, excess = 0.0 } }  # Eq. 6
optimisation = { learning_rate = 2e-5, schedule = "constant", warm_up = 2000, weight_decay = 0.0, clip = 0.0, accumulate = 1, ema = 0.999, adam = { beta1 = 0.5, beta2 = 0.999, epsilon = 1e-4 } }  # [D], [code]

[svbrdf.videos]                                      # §4: a third of the paths are lines
noise_scale = 1.0
path = { template = "spiral", line_share = 0.333333, line_order = "scan", unit_length = "view", deviation_scale = 1.0, roll_deg = 0.0, frame_rate = 1.0, frames = 141 }
augment = { flip = 0.5, scale = [0.8, 1.25], roughness_floor = 0.1, perlin = 0.5, perlin_wavelength = [16, 64], perlin_masks = 100 }
light = { kind = "svbrdf", ambient = [0, 0], environments = "" }
"#;

/// Keys of these tables that are no part of the method: what is watched, measured or held in memory, the look of the generated
/// pairs that stand for FlyingChairs, and the end of a teaching that doesn't take place.
const OURS: [&str; 10] = [
    "preview_every",
    "validate_every",
    "histogram_every",
    "validation_pairs",
    "validation_exemplars",
    "median_exemplars",
    "background_px",
    "shape_px",
    "pool_materials",
    "pool_pairs",
];

fn flatten(prefix: &str, value: &toml::Value, into: &mut BTreeMap<String, toml::Value>) {
    match value {
        toml::Value::Table(table) => {
            table.iter().for_each(|(key, value)| flatten(&format!("{prefix}.{key}"), value, into));
        }
        toml::Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, value)| flatten(&format!("{prefix}.{i}"), value, into));
        }
        other => drop(into.insert(prefix.into(), other.clone())),
    }
}

fn keys(text: &str, tables: &[&str]) -> BTreeMap<String, toml::Value> {
    let root: toml::Table = text.parse().unwrap_or_else(|error| panic!("{error}"));
    let mut keys = BTreeMap::new();
    tables.iter().for_each(|table| flatten(table, &root[*table], &mut keys));
    keys.retain(|key, _| !OURS.contains(&key.rsplit('.').next().unwrap_or(key)) && !key.ends_with("teaching.until"));
    keys
}

fn equal(a: &toml::Value, b: &toml::Value) -> bool {
    let number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    match (number(a), number(b)) {
        (Some(a), Some(b)) => (a - b).abs() <= 2e-6 * a.abs().max(b.abs()),
        _ => a == b,
    }
}

#[test]
fn the_paper_config_is_the_papers_recipe_key_by_key() {
    let config = Config::load("paper", &[]).unwrap();
    let tables = ["flow", "chairs", "adjacent", "distant", "svbrdf"];
    let (found, expected) = (keys(&config.to_toml(), &tables), keys(RECIPE, &tables));
    for (key, value) in &expected {
        let found = found.get(key).unwrap_or_else(|| panic!("`{key}` is no key of the config"));
        assert!(equal(found, value), "`{key}` is {found} instead of {value}");
    }
    let unknown: Vec<_> = found.keys().filter(|key| !expected.contains_key(*key)).collect();
    assert!(unknown.is_empty(), "is this part of the paper's recipe? {unknown:?}");
}

#[test]
fn the_paper_config_is_measured_as_in_the_paper() {
    let config = Config::load("paper", &[]).unwrap();
    // §8.1: 1,024² from 29 key frames, every fifth of 141 frames.
    let protocol = &config.report.synthetic;
    assert_eq!((protocol.resolution, protocol.map_resolution, protocol.align.key_frame_step), (1024, 1024, 5));
    assert_eq!(config.run.compute, ops::compute::Compute::F32);
}
