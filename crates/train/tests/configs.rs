//! Every config of the repository loads, and layers do what they say.

use std::path::PathBuf;

use dataset::sequence::sensor::{CompressionConfig, SensorConfig};
use flow::pwc::{Connections, Prediction, PwcConfig, Upsampling};
use train::config::{Config, FlowInit, Schedule};
use train::sweep::{Sweep, plan};

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../configs")
}

#[test]
fn every_config_in_the_repository_loads_and_survives_being_written_out() {
    let mut seen = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if std::fs::read_to_string(&path).unwrap().contains("\nbase = ") {
            let sweep = Sweep::load(path.to_str().unwrap(), &[]).unwrap_or_else(|error| panic!("{error}"));
            assert!(sweep.members.len() > 1, "{}", path.display());
            continue;
        }
        let config = Config::load(path.to_str().unwrap(), &[]).unwrap_or_else(|error| panic!("{error}"));
        let again: Config = toml::from_str(&config.to_toml()).unwrap();
        assert_eq!(config, again, "{}", path.display());
        seen += 1;
    }
    assert!(seen >= 4, "{seen} configs");
}

#[test]
fn the_reference_page_is_what_the_program_prints() {
    let path = folder().join("../docs/config.md");
    let page = std::fs::read_to_string(path).unwrap();
    assert!(
        page == train::config::reference::markdown(),
        "docs/config.md is old: make it anew with `cargo run -p train -- config-reference > docs/config.md`"
    );
}

#[test]
fn the_ablation_is_the_papers_table_2() {
    let sweep = Sweep::load("ablation", &[]).unwrap();
    let row = |name: &str| &sweep.members.iter().find(|member| member.row == name).unwrap().config;
    let full = row("full");
    assert_eq!(sweep.question.variants.len(), 6);
    assert_eq!((full.svbrdf.videos.augment.perlin, full.svbrdf.loss.weights.top), (0.5, 1.0));
    assert_eq!(row("no-perlin").svbrdf.videos.augment.perlin, 0.0);
    assert_eq!(row("no-top-loss").svbrdf.loss.weights.top, 0.0);
    assert_eq!(row("instance-norm").svbrdf.net.normalisation, svbrdf::net::Normalisation::Instance);
    assert_eq!(row("frame-warping").svbrdf.net.fusion, svbrdf::net::Fusion::Frames);
    let unregular = &row("no-regularisation").report.synthetic.align;
    assert_eq!(unregular.regularise, flow::align::Regularise::None);
    // Five nets per seed, no flow net, and the alignment's row takes the first of them.
    let runs = plan(&sweep.members);
    let trained = |seed| runs.iter().filter(|run| run.seed == seed).map(|run| run.trains(&runs)).collect::<Vec<_>>();
    assert_eq!(trained(2), ["svbrdf", "svbrdf", "svbrdf", "svbrdf", "nothing", "svbrdf"]);
    // Each other row differs from the full method in one key.
    for name in ["no-perlin", "no-top-loss", "instance-norm", "frame-warping", "no-regularisation"] {
        let (full, other) = (full.to_toml(), row(name).to_toml());
        let differing = full.lines().zip(other.lines()).filter(|(a, b)| a != b && !a.starts_with("name = ")).count();
        assert_eq!((differing, full.lines().count()), (1, other.lines().count()), "{name}");
    }
    let published = sweep.question.published.unwrap().figures;
    assert_eq!(published["instance-norm"]["dssim"], 0.2581);
}

#[test]
fn a_config_is_found_by_its_bare_name_from_any_folder() {
    // The test's own working folder is the crate, which has no configs/.
    assert_eq!(Config::load("smoke", &[]).unwrap(), Config::load("smoke.toml", &[]).unwrap());
    assert_eq!(Config::load("smoke", &[]).unwrap().run.name, "smoke");
}

#[test]
fn smoke_inherits_what_it_does_not_change() {
    let (spiral, smoke) = (Config::load("spiral", &[]).unwrap(), Config::load("smoke", &[]).unwrap());
    assert_eq!(smoke.svbrdf.net, spiral.svbrdf.net);
    assert_eq!(smoke.flow.init, FlowInit::None);
    assert!(smoke.adjacent.steps < spiral.adjacent.steps && smoke.adjacent.steps > 0);
    assert_eq!(smoke.adjacent.optimisation.schedule, Schedule::OneCycle);
}

#[test]
fn a_table_given_in_part_keeps_the_programs_defaults() {
    let home = tempfile::tempdir().unwrap();
    let path = home.path().join("part.toml");
    std::fs::write(&path, "[adjacent]\nsteps = 1\nvideos = { noise_scale = 0.5 }\n").unwrap();
    let config = Config::load(path.to_str().unwrap(), &[]).unwrap();
    let flow_videos = dataset::sequence::SequenceConfig::flow();
    assert_eq!(config.adjacent.videos, dataset::sequence::SequenceConfig { noise_scale: 0.5, ..flow_videos });
}

#[test]
fn the_papers_videos_have_an_ideal_sensor_and_the_main_jobs_have_a_phones() {
    let compression = Some(CompressionConfig { quality: [70, 95] });
    let phone = SensorConfig { compression, ..SensorConfig::phone() };
    for (name, sensor) in [("paper", SensorConfig::default()), ("spiral", phone)] {
        let config = Config::load(name, &[]).unwrap();
        for videos in [&config.adjacent.videos, &config.distant.videos, &config.svbrdf.videos] {
            assert_eq!(videos.sensor, sensor, "{name}");
        }
    }
}

#[test]
fn sensor_options_are_tables_of_the_videos() {
    let home = tempfile::tempdir().unwrap();
    let load = |text: &str| {
        let path = home.path().join("sensor.toml");
        std::fs::write(&path, format!("[svbrdf]\nsteps = 1\n{text}")).unwrap();
        Config::load(path.to_str().unwrap(), &[])
    };
    let config = load("[svbrdf.videos.sensor]\nmotion_blur = { sub_frames = 4 }\nvignetting = {}\n").unwrap();
    let sensor = &config.svbrdf.videos.sensor;
    assert_eq!(sensor.motion_blur.map(|blur| (blur.shutter, blur.sub_frames)), Some(([0.1, 0.5], 4)));
    assert!(sensor.vignetting.is_some() && sensor.compression.is_none());
    assert_eq!(config.adjacent.videos.sensor, Default::default());
    assert_eq!(toml::from_str::<Config>(&config.to_toml()).unwrap(), config);
    let text = load("[svbrdf.videos.sensor]\ncompression = { quality = [0, 50] }\n").unwrap_err().to_string();
    assert!(text.contains("sensor.compression.quality is [0, 50]") && text.contains("sensor.toml"), "{text}");
    let text = load("[svbrdf.videos.sensor]\nvigneting = {}\n").unwrap_err().to_string();
    assert!(text.contains("vigneting") && text.contains("vignetting"), "{text}");
}

#[test]
fn the_flow_nets_are_named_or_described() {
    let load = |set: &str| Config::load("spiral", &[set.into()]).map_err(|e| e.to_string());
    assert_eq!(load("flow.size=published").unwrap().flow.architecture(), PwcConfig::published());
    let keys = r#"connections="dense", upsampling="deconvolution", prediction="direct", coarsest_features=false"#;
    let config = load(&format!("flow.architecture={{channels=[8, 16, 24], {keys}}}")).unwrap();
    let expected = PwcConfig {
        channels: vec![8, 16, 24],
        connections: Connections::Dense,
        upsampling: Upsampling::Deconvolution,
        prediction: Prediction::Direct,
        coarsest_features: false,
        ..PwcConfig::paper()
    };
    assert_eq!(config.flow.architecture(), expected);
    assert_eq!(toml::from_str::<Config>(&config.to_toml()).unwrap(), config);
    let text = load(r#"flow.architecture={connections="dense"}"#).unwrap_err();
    assert!(text.contains("upsampling = \"deconvolution\""), "{text}");
    let text = load(r#"flow.architecture={connections="dence"}"#).unwrap_err();
    assert!(text.contains("dence") && text.contains("dense"), "{text}");
}

#[test]
fn any_number_of_steps_counts_as_steps() {
    let set = ["chairs.steps=9223372036854775807", "adjacent.steps=9223372036854775807", "distant.steps=2", "svbrdf.steps=0"];
    assert_eq!(Config::load("spiral", &set.map(String::from)).unwrap().distant.steps, 2);
}

#[test]
fn assignments_lie_on_top_and_take_plain_words() {
    let set = ["run.seed=7", "flow.init=none", "adjacent.optimisation.schedule=constant", "svbrdf.exemplars.key_frames=[1, 3]"];
    let config = Config::load("spiral", &set.map(String::from)).unwrap();
    assert_eq!(config.run.seed, 7);
    assert_eq!(config.flow.init, FlowInit::None);
    assert_eq!(config.adjacent.optimisation.schedule, Schedule::Constant);
    assert_eq!(config.svbrdf.exemplars.key_frames, [1, 3]);
}

#[test]
fn sources_of_materials_say_what_nobody_can_guess() {
    let load = |sources: &str| Config::load("spiral", &[format!("materials={sources}")]).map_err(|e| e.to_string());
    let strips = r#"[{type="inria", path=".", albedo_encoding="gamma", weight=2.0}, {type="procedural"}]"#;
    let config = load(strips).unwrap();
    assert_eq!(config, toml::from_str(&config.to_toml()).unwrap());
    assert_eq!(config.materials.iter().map(|source| source.weight()).collect::<Vec<_>>(), [2.0, 1.0]);
    for (sources, parts) in [
        (r#"[{type="inria", path="."}]"#, ["missing key `albedo_encoding`", "no default"]),
        (r#"[{type="npy", path=".", albedo_encoding="linear"}]"#, ["missing key `roughness_squared`", "no default"]),
        (r#"[{type="inria", path=".", albedo_encoding="srgb"}]"#, ["unknown value `srgb`", "gamma, linear"]),
        (r#"[{type="npi", path="."}]"#, ["unknown value `npi`", "did you mean `npy`?"]),
        (
            r#"[{type="npy", path="no/such", albedo_encoding="linear", roughness_squared=true}]"#,
            ["source 1 (npy): path is no/such", ".txt list"],
        ),
    ] {
        let text = load(sources).unwrap_err();
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    }
}

#[test]
fn all_impossible_values_are_told_at_once() {
    let set = [
        "adjacent.batch=0",
        "svbrdf.optimisation.learning_rate=-1.0",
        "distant.teaching.until=2.0",
        "svbrdf.loss.weights.excess=-0.5",
    ]
    .map(String::from);
    let text = Config::load("spiral", &set).unwrap_err().to_string();
    for part in [
        "`adjacent.batch` is 0",
        "`svbrdf.optimisation.learning_rate` is -1",
        "`distant.teaching.until` is 2",
        "`svbrdf.loss.weights.excess` is -0.5",
    ] {
        assert!(text.contains(part), "{text}");
    }
}
