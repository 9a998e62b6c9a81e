//! Laws of the SVBRDF net: invariances, sizes, streaming.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Tensor, TensorData};
use ops::compute::Compute;
use ops::planes::{Planes, values};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use render::svbrdf::{Svbrdf, SvbrdfImage};
use render::texel::Texel;
use svbrdf::constants::ConstantMaps;
use svbrdf::net::{
    FitExemplar, Fusion, FusionError, KeyFrame, NetConfigError, Normalisation, PixelFeatures, Pooling, SvbrdfNet,
    SvbrdfNetConfig,
};
use svbrdf::weights::{self, Precision};

const POOLINGS: [Pooling; 4] = [Pooling::Max, Pooling::Mean, Pooling::MaxMeanVariance, Pooling::Attention];

fn stream(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn small(levels: usize) -> SvbrdfNetConfig {
    SvbrdfNetConfig { width: 4, levels, ..SvbrdfNetConfig::default() }
}

fn net(config: &SvbrdfNetConfig, device: &Device) -> SvbrdfNet {
    // A gain of 1 makes the maps depend visibly on the features.
    let mut config = config.clone();
    config.output.gain = 1.0;
    let net = config.init(device, &mut stream(1)).expect("a valid config");
    if config.pooling == Pooling::Attention { net.map(&mut Learnt(stream(9))) } else { net }
}

/// Draws what is zero at first: attention starts as the mean.
struct Learnt(ChaCha8Rng);

impl ModuleMapper for Learnt {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        if values(param.val()).iter().any(|v| *v != 0.0) {
            return param;
        }
        let (id, shape) = (param.id, param.dims());
        let drawn: Vec<f32> = (0..shape.iter().product()).map(|_| self.0.random_range(-2.0..2.0)).collect();
        let drawn = Tensor::from_data(TensorData::new(drawn, shape), &param.val().device());
        param.transform_for_load(drawn, id)
    }
}

fn frames(count: usize, h: usize, w: usize, device: &Device) -> Tensor<4> {
    let mut rng = stream(2);
    let data: Vec<f32> = (0..count * 3 * h * w).map(|_| rng.random()).collect();
    Tensor::from_data(TensorData::new(data, [count, 3, h, w]), device)
}

/// A different fractional shift per key frame.
fn flows(count: usize, h: usize, w: usize, device: &Device) -> Tensor<4> {
    let shifts = (0..count).flat_map(|k| [1.25 * (k + 1) as f32, -0.75 * k as f32]);
    let data: Vec<f32> = shifts.flat_map(|s| std::iter::repeat_n(s, h * w)).collect();
    Tensor::from_data(TensorData::new(data, [count, 2, h, w]), device)
}

fn all_values(maps: Svbrdf) -> Vec<f32> {
    [maps.normal, maps.diffuse, maps.roughness, maps.specular].into_iter().flat_map(values).collect()
}

fn assert_same(a: &[f32], b: &[f32], tolerance: f32) {
    assert_eq!(a.len(), b.len());
    let worst = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst <= tolerance, "largest difference {worst}");
}

fn differ(a: &[f32], b: &[f32]) -> bool {
    a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-4)
}

#[test]
fn filters_have_unit_norm_under_weight_normalisation_only() {
    let device = Device::flex();
    let norms = |net: &SvbrdfNet| -> Vec<f32> {
        net.convolutions()
            .flat_map(|c| {
                let filters = c.filters();
                let [out, inputs, _, _] = filters.dims();
                values(filters.reshape([out, inputs * 9]).square().sum_dim(1).sqrt())
            })
            .collect()
    };
    let weight = norms(&net(&small(3), &device));
    assert!(weight.len() > 50 && weight.iter().all(|n| (n - 1.0).abs() < 1e-3));
    let instance = norms(&net(&SvbrdfNetConfig { normalisation: Normalisation::Instance, ..small(3) }, &device));
    assert!(instance.iter().all(|n| *n < 0.5));
}

#[test]
fn the_maps_are_the_same_by_kernels_and_by_what_other_devices_compute() {
    let device = Device::flex();
    let instance = SvbrdfNetConfig { normalisation: Normalisation::Instance, ..small(4) };
    let fusions = [Fusion::Frames, Fusion::None].map(|fusion| SvbrdfNetConfig { fusion, ..small(4) });
    let poolings = POOLINGS.map(|pooling| SvbrdfNetConfig { pooling, ..small(4) });
    for config in [small(8), instance].into_iter().chain(fusions).chain(poolings) {
        let net = net(&config, &device);
        let maps = || all_values(net.forward(frames(3, 26, 35, &device), flows(2, 26, 35, &device), None));
        assert_same(&maps(), &ops::kernel::without(maps), 1e-4);
    }
}

#[test]
fn half_precision_rounds_maps_and_gradients_and_no_more() {
    let device = Device::flex().autodiff();
    // Gradients jump where rounding moves a maximum or an activation to its other side. Instance normalisation divides by small
    // deviations, which magnifies what was rounded before.
    let instance = SvbrdfNetConfig { normalisation: Normalisation::Instance, ..small(3) };
    for (config, size, limit) in [(small(5), 32, 0.03), (small(5), 48, 0.03), (instance, 32, 0.3)] {
        let net = net(&config, &device);
        let step = || {
            let maps = net.forward(frames(3, size, size, &device), flows(2, size, size, &device), None).stacked();
            let gradients = (maps.clone() - 0.3).square().mean().mul_scalar(1e4).backward();
            let filters = net.convolutions().map(|c| values(c.parameter().grad(&gradients).expect("every filter has one")));
            (values(maps), filters.flatten().collect::<Vec<f32>>())
        };
        let norm = |v: &[f32]| v.iter().map(|v| f64::from(v * v)).sum::<f64>().sqrt();
        let difference = |a: &[f32], b: &[f32]| norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b);
        let single = step();
        for (format, rounding) in [(Compute::F16, 1.0 / 2048.0), (Compute::Bf16, 1.0 / 256.0)] {
            let half = format.within(step);
            let (maps, gradients) = (difference(&half.0, &single.0), difference(&half.1, &single.1));
            println!("{format:?}, {size}²: maps {maps:.1e}, gradients {gradients:.1e}");
            assert!(maps > 0.0 && maps < 16.0 * rounding, "{format:?}: maps {maps}");
            assert!(gradients > 0.0 && gradients < limit, "{format:?}: gradients {gradients}");
        }
    }
}

#[test]
fn maps_are_in_range_at_any_size() {
    let device = Device::flex();
    for (config, h, w) in [(small(8), 24, 40), (small(3), 7, 13), (small(8), 1, 1), (small(5), 33, 20)] {
        let maps = net(&config, &device).forward(frames(2, h, w, &device), flows(1, h, w, &device), None);
        assert_eq!(maps.normal.dims(), [1, 3, h, w]);
        assert_eq!(maps.roughness.dims(), [1, 1, h, w]);
        let length = values(maps.normal.clone().square().sum_dim(1));
        assert!(length.iter().all(|l| (l - 1.0).abs() < 1e-5));
        for map in [maps.diffuse, maps.roughness, maps.specular] {
            assert!(values(map).iter().all(|v| (0.0..=1.0).contains(v)));
        }
    }
}

#[test]
fn order_of_key_frames_does_not_matter() {
    let device = Device::flex();
    let fusions = [Fusion::Features, Fusion::Frames, Fusion::None];
    for (fusion, pooling) in fusions.into_iter().flat_map(|f| POOLINGS.map(|p| (f, p))) {
        let net = net(&SvbrdfNetConfig { fusion, pooling, ..small(4) }, &device);
        let (x, flow) = (frames(4, 16, 16, &device), flows(3, 16, 16, &device));
        let order = |indices: [i32; 3]| {
            let keys = Tensor::from_data(TensorData::from(indices), &device);
            let with_guidance =
                Tensor::from_data(TensorData::from([0, indices[0] + 1, indices[1] + 1, indices[2] + 1]), &device);
            all_values(net.forward(x.clone().select(0, with_guidance), flow.clone().select(0, keys), None))
        };
        // A sum's last figure depends on the order.
        assert_same(&order([0, 1, 2]), &order([2, 0, 1]), if pooling == Pooling::Max { 1e-6 } else { 1e-5 });
    }
}

/// One value per key frame.
fn masks(of_frames: &[f32], h: usize, w: usize, device: &Device) -> Tensor<4> {
    let data: Vec<f32> = of_frames.iter().flat_map(|v| std::iter::repeat_n(*v, h * w)).collect();
    Tensor::from_data(TensorData::new(data, [of_frames.len(), 1, h, w]), device)
}

#[test]
fn a_fully_invalid_frame_changes_nothing_and_a_valid_one_does() {
    let device = Device::flex();
    for pooling in POOLINGS {
        let net = net(&SvbrdfNetConfig { pixel_features: PixelFeatures::Extremes, pooling, ..small(4) }, &device);
        let (x, flow) = (frames(3, 16, 16, &device), flows(2, 16, 16, &device));
        let one = flow.clone().slice([0..1, 0..2, 0..16, 0..16]);
        let two = all_values(net.forward(x.clone().slice([0..2, 0..3, 0..16, 0..16]), one.clone(), None));
        let third = |valid: f32| all_values(net.forward(x.clone(), flow.clone(), Some(masks(&[1.0, valid], 16, 16, &device))));
        assert_same(&two, &third(0.0), 1e-6);
        assert!(differ(&two, &third(1.0)));
        let far = Tensor::cat(vec![one, Tensor::full([1, 2, 16, 16], 1e4, &device)], 0);
        assert_same(&two, &all_values(net.forward(x.clone(), far, None)), 1e-6);
        // Attention weighs a doubtful frame, the other poolings leave it out.
        let doubtful = third(0.3);
        match pooling {
            Pooling::Attention => assert!(differ(&two, &doubtful) && differ(&third(1.0), &doubtful)),
            _ => assert_same(&two, &doubtful, 1e-6),
        }
    }
}

/// The maps of frames that arrive one after another.
fn streamed(net: &SvbrdfNet, frames: Tensor<4>, flow: Vec<Planes>, valid: Option<Tensor<4>>, device: &Device) -> Vec<f32> {
    let mut images = Planes::from_tensor(frames).into_iter();
    let guidance = images.next().unwrap();
    let mut masks = valid.map(|v| Planes::from_tensor(v).into_iter());
    let keys = images.zip(flow).map(|(frame, flow)| KeyFrame { frame, flow, valid: masks.as_mut().and_then(Iterator::next) });
    let maps = net.reconstruct(&guidance, keys, device).unwrap();
    [maps.normal, maps.diffuse, maps.roughness, maps.specular].into_iter().flat_map(|p| p.data).collect()
}

#[test]
fn streamed_frames_give_the_maps_of_all_at_once() {
    let device = Device::flex();
    let fusions = [
        (Fusion::Features, PixelFeatures::None),
        (Fusion::Features, PixelFeatures::Extremes),
        (Fusion::Frames, PixelFeatures::None),
        (Fusion::None, PixelFeatures::None),
    ];
    for ((fusion, pixel_features), pooling) in fusions.into_iter().flat_map(|f| POOLINGS.map(|p| (f, p))) {
        let net = net(&SvbrdfNetConfig { fusion, pixel_features, pooling, ..small(4) }, &device);
        let (x, flow) = (frames(4, 20, 12, &device), flows(3, 20, 12, &device));
        for valid in [None, Some(masks(&[0.2, 1.0, 0.7], 20, 12, &device))] {
            let at_once = all_values(net.forward(x.clone(), flow.clone(), valid.clone()));
            let streamed = streamed(&net, x.clone(), Planes::from_tensor(flow.clone()), valid, &device);
            assert_same(&at_once, &streamed, 1e-5);
        }
    }
}

#[test]
fn a_single_pixel_and_a_single_frame_are_pooled_too() {
    let device = Device::flex();
    let single = |pooling: Pooling, size: usize| {
        let net = net(&SvbrdfNetConfig { pooling, ..small(3) }, &device);
        let none = Tensor::zeros([1, 2, size, size], &device).slice([0..0, 0..2, 0..size, 0..size]);
        let maps = all_values(net.forward(frames(1, size, size, &device), none, None));
        assert_same(&maps, &streamed(&net, frames(1, size, size, &device), Vec::new(), None, &device), 1e-5);
        let still = Tensor::zeros([2, 2, size, size], &device);
        let three = all_values(net.forward(frames(3, size, size, &device), still.clone(), None));
        assert!(three.iter().all(|v| v.is_finite()) && differ(&three, &maps));
        let steps = streamed(&net, frames(3, size, size, &device), Planes::from_tensor(still), None, &device);
        assert_same(&three, &steps, 1e-5);
        maps
    };
    for size in [1, 6] {
        // The maximum and the mean of one frame are the frame.
        assert_eq!(single(Pooling::Max, size), single(Pooling::Mean, size));
        single(Pooling::MaxMeanVariance, size);
        single(Pooling::Attention, size);
    }
}

#[test]
fn attention_starts_as_the_mean() {
    let device = Device::flex();
    let maps = |pooling: Pooling| {
        let net = SvbrdfNetConfig { pooling, ..small(3) }.init(&device, &mut stream(1)).unwrap();
        all_values(net.forward(frames(3, 8, 8, &device), flows(2, 8, 8, &device), None))
    };
    assert_eq!(maps(Pooling::Attention), maps(Pooling::Mean));
}

#[test]
fn a_key_frame_of_another_size_is_refused() {
    let device = Device::flex();
    let net = net(&small(2), &device);
    let key = KeyFrame { frame: Planes::new(3, 8, 8), flow: Planes::new(2, 8, 9), valid: None };
    let error = net.reconstruct(&Planes::new(3, 8, 8), [key], &device).unwrap_err();
    let FusionError::Size { what, index, found, .. } = &error;
    assert_eq!((*what, *index, found.as_str()), ("flow", 0, "2×8×9"));
    assert!(error.to_string().contains("resize"));
}

#[test]
fn outputs_start_at_the_constants() {
    let device = Device::flex();
    let constants = ConstantMaps { diffuse: [0.3, 0.2, 0.1], roughness: 0.6, specular: [0.04, 0.05, 0.06] };
    let net = small(4).init(&device, &mut stream(3)).unwrap().starting_at(&constants);
    let maps = net.forward(frames(2, 16, 16, &device), flows(1, 16, 16, &device), None).to_images().remove(0);
    let near = |plane: &[f32], v: f32| plane.iter().all(|p| (p - v).abs() < 0.02);
    assert!(
        (0..3)
            .all(|c| near(maps.diffuse.plane(c), constants.diffuse[c]) && near(maps.specular.plane(c), constants.specular[c]))
    );
    assert!(near(&maps.roughness.data, 0.6) && near(maps.normal.plane(2), 1.0));
}

#[test]
fn dropout_follows_its_stream_and_stays_out_of_inference() {
    let device = Device::flex();
    let net = net(&small(4), &device);
    let (x, flow) = (frames(2, 16, 16, &device), flows(1, 16, 16, &device));
    let drawn = |seed: u64| all_values(net.predict(x.clone(), flow.clone(), None, Some(&mut stream(seed))).maps);
    let plain = all_values(net.forward(x.clone(), flow.clone(), None));
    assert_eq!(drawn(7), drawn(7));
    assert!(differ(&drawn(7), &drawn(8)) && differ(&drawn(7), &plain));
}

#[test]
fn saturation_counts_flat_outputs() {
    let device = Device::flex();
    let tame = net(&small(3), &device).predict(
        frames(1, 8, 8, &device),
        flows(1, 8, 8, &device).slice([0..0, 0..2, 0..8, 0..8]),
        None,
        None,
    );
    assert!(tame.saturation() < 0.5);
    let logits = Tensor::cat(vec![Tensor::full([1, 3, 2, 2], -2.7, &device), Tensor::zeros([1, 6, 2, 2], &device)], 1);
    assert!((svbrdf::net::Prediction { logits, ..tame }.saturation() - 1.0 / 3.0).abs() < 1e-6);
}

#[test]
fn outputs_that_tipped_over_have_a_way_back() {
    let device = Device::flex().autodiff();
    let tame = net(&small(3), &device).predict(
        frames(1, 8, 8, &device),
        flows(1, 8, 8, &device).slice([0..0, 0..2, 0..8, 0..8]),
        None,
        None,
    );
    let logits = Tensor::<1>::from_floats([-2.0, 0.0, 2.0, 40.0, -40.0, 0.0, 0.0, 0.0, 0.0], &device).require_grad();
    let tipped = svbrdf::net::Prediction { logits: logits.clone().reshape([1, 9, 1, 1]), ..tame };
    let excess = tipped.excess();
    // 2 · (40 − 2.3)² / 9
    assert!((values(excess.clone())[0] / 315.84 - 1.0).abs() < 1e-4, "{}", values(excess.clone())[0]);
    let slopes = values(logits.grad(&excess.backward()).expect("logits are tracked"));
    assert!(slopes[3] > 1.0 && slopes[4] < -1.0 && slopes[..3].iter().all(|s| *s == 0.0), "{slopes:?}");
}

#[test]
fn albedos_start_at_what_the_colours_tell() {
    let device = Device::flex();
    let constants = ConstantMaps { diffuse: [0.3; 3], roughness: 0.6, specular: [0.04; 3] };
    let config = SvbrdfNetConfig { pixel_features: PixelFeatures::Extremes, ..small(3) };
    let start = config.init(&device, &mut stream(3)).unwrap().starting_at(&constants);
    // Still frames in which a rough material's diffuse albedo is what the camera sees.
    let exemplar = |seed: u64| {
        let mut rng = stream(seed);
        let tint: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.2..0.8));
        let shade: Vec<f32> = (0..32 * 32).map(|_| rng.random_range(0.7..1.2)).collect();
        let texel = Texel { normal: [0.0, 0.0, 1.0], diffuse: [0.0; 3], roughness: 0.9, specular: [0.04; 3] };
        let mut target = SvbrdfImage::constant(32, 32, &texel);
        let colours = tint.iter().flat_map(|t| shade.iter().map(move |s| t * s)).collect();
        target.diffuse = Planes::from_vec(3, 32, 32, colours);
        let frame = target.diffuse.clone().map(|v| v.powf(1.0 / 2.2)).to_tensor(&device);
        let frames = Tensor::cat(vec![frame.clone(), frame], 0);
        FitExemplar {
            frames,
            flow: Tensor::zeros([1, 2, 32, 32], &device),
            valid: Tensor::ones([1, 1, 32, 32], &device),
            target,
        }
    };
    let net = start.clone().fitted_to((0..12).map(|i| Ok::<_, ()>(exemplar(i)))).unwrap();
    let error = |net: &SvbrdfNet| {
        let FitExemplar { frames, flow, target, .. } = exemplar(99);
        let maps = net.forward(frames, flow, None).to_images().remove(0);
        let roughness = values(maps.roughness.to_tensor(&device))[0];
        (svbrdf::metrics::MapErrors::between(&maps, &target, None).unwrap(), roughness)
    };
    let ((before, rough), (after, still_rough)) = (error(&start), error(&net));
    assert!(after.diffuse_l1 < 0.3 * before.diffuse_l1, "{} → {}", before.diffuse_l1, after.diffuse_l1);
    assert_eq!((after.normal_l1, still_rough), (before.normal_l1, rough));
    let unfitted = start.clone().fitted_to(std::iter::empty::<Result<FitExemplar, ()>>()).unwrap();
    assert_eq!(error(&unfitted).0, before);
}

#[test]
fn a_saved_net_comes_back_whole() {
    let device = Device::flex();
    let net = net(&SvbrdfNetConfig { fusion: Fusion::Frames, ..small(3) }, &device);
    let folder = tempfile::tempdir().unwrap();
    let metrics = [("maps_l1_ratio".to_owned(), 0.8)].into();
    weights::save(folder.path(), &net, "a test".into(), metrics, Precision::F32).unwrap();
    let (read, record) = weights::load(folder.path(), &device).unwrap();
    assert_eq!((read.config(), record.metrics["maps_l1_ratio"]), (net.config(), 0.8));
    let maps = |net: &SvbrdfNet| all_values(net.forward(frames(2, 8, 8, &device), flows(1, 8, 8, &device), None));
    assert_eq!(maps(&read), maps(&net));
}

#[test]
fn weights_of_another_pooling_are_refused() {
    let device = Device::flex();
    let folder = tempfile::tempdir().unwrap();
    let manifest = folder.path().join("manifest.json");
    // What is said of a net's file under a manifest that names another pooling.
    let refused = |written: Pooling, named: &str| {
        let net = net(&SvbrdfNetConfig { pooling: written, ..small(2) }, &device);
        weights::save(folder.path(), &net, "a test".into(), [].into(), Precision::F32).unwrap();
        let mut record: serde_json::Value = serde_json::from_slice(&std::fs::read(&manifest).unwrap()).unwrap();
        record["nets"]["svbrdf"].as_object_mut().unwrap().remove("sha256");
        record["nets"]["svbrdf"]["architecture"]["pooling"] = named.into();
        std::fs::write(&manifest, serde_json::to_vec(&record).unwrap()).unwrap();
        weights::load(folder.path(), &device).unwrap_err().to_string()
    };
    let error = refused(Pooling::Max, "attention");
    assert!(error.contains("lacks `attention.global.confidence`") && error.contains("another architecture"), "{error}");
    let error = refused(Pooling::Attention, "max");
    assert!(error.contains("holds `attention.") && error.contains("this architecture hasn't"), "{error}");
    let error = refused(Pooling::Max, "max-mean-variance");
    assert!(error.contains("`head.layers.0.convolution.weight`") && error.contains("has shape"), "{error}");
    let error = refused(Pooling::Max, "median");
    assert!(error.contains("median") && error.contains("max-mean-variance"), "{error}");
}

#[test]
fn the_size_of_a_net_is_known_before_it_is_built() {
    let device = Device::flex();
    let extremes = SvbrdfNetConfig { pixel_features: PixelFeatures::Extremes, fusion: Fusion::Frames, ..small(2) };
    let instance = SvbrdfNetConfig { normalisation: Normalisation::Instance, ..small(8) };
    let poolings = POOLINGS.map(|pooling| SvbrdfNetConfig { pooling, ..extremes.clone() });
    for config in
        [small(1), small(5), SvbrdfNetConfig { width: 70, ..small(1) }, extremes, instance].into_iter().chain(poolings)
    {
        assert_eq!(config.parameters(), net(&config, &device).num_params(), "{config:?}");
    }
}

#[test]
fn values_out_of_range_are_refused() {
    let wrong = |c: SvbrdfNetConfig| c.validate().unwrap_err();
    assert_eq!(wrong(SvbrdfNetConfig { width: 0, ..small(3) }), NetConfigError::Width { found: 0 });
    assert_eq!(wrong(small(9)), NetConfigError::Levels { found: 9 });
    assert_eq!(wrong(SvbrdfNetConfig { dropout: 1.0, ..small(3) }), NetConfigError::Dropout { found: 1.0 });
    assert!(toml::from_str::<SvbrdfNetConfig>("widht = 3").is_err());
    let read: SvbrdfNetConfig = toml::from_str("width = 16\nfusion = 'frames'\n[output]\nstart = 'medians'").unwrap();
    assert_eq!((read.width, read.levels, read.fusion, read.pooling), (16, 8, Fusion::Frames, Pooling::Max));
    let names = ["max", "mean", "max-mean-variance", "attention"];
    for (name, pooling) in names.into_iter().zip(POOLINGS) {
        assert_eq!(toml::from_str::<SvbrdfNetConfig>(&format!("pooling = '{name}'")).unwrap().pooling, pooling);
    }
}

struct Gradients<'a> {
    gradients: &'a burn::tensor::Gradients,
    seen: usize,
    silent: usize,
}

impl ModuleVisitor for Gradients<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let gradient = param.val().grad(self.gradients).map(values).unwrap_or_default();
        assert!(gradient.iter().all(|g| g.is_finite()));
        self.seen += 1;
        self.silent += usize::from(gradient.iter().all(|g| *g == 0.0));
    }
}

#[test]
fn gradients_are_finite_and_reach_every_parameter() {
    let device = Device::flex().autodiff();
    let instance = SvbrdfNetConfig { normalisation: Normalisation::Instance, ..small(3) };
    for config in POOLINGS.map(|pooling| SvbrdfNetConfig { pooling, ..small(3) }).into_iter().chain([instance]) {
        let net = net(&config, &device);
        // Black pixels and invalid pixels are where powers and masks go wrong.
        let x = frames(3, 16, 16, &device) * Tensor::from_data(TensorData::from([[[[0.0f32]]], [[[1.0]]], [[[1.0]]]]), &device);
        // A factor on the confidence learns where confidences differ.
        let maps = net.forward(x, flows(2, 16, 16, &device), Some(masks(&[1.0, 0.6], 16, 16, &device)));
        let loss = maps.normal.slice([0..1, 0..2, 0..16, 0..16]).sum()
            + maps.diffuse.sum()
            + maps.roughness.sum()
            + maps.specular.sum();
        let gradients = loss.backward();
        let mut visitor = Gradients { gradients: &gradients, seen: 0, silent: 0 };
        net.visit(&mut visitor);
        // The last layer of the head has no one to pass its global vector on to.
        assert!(visitor.seen > 30 && visitor.silent <= 2, "{} of {} without gradient", visitor.silent, visitor.seen);
    }
}
