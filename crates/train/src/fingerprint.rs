//! Digests of what decides the results: a checkpoint goes on only under the config that wrote it.

use crate::config::Config;
use crate::pipeline::Part;
use sha2::{Digest, Sha256};

/// Keys that came after the first checkpoints, at the values that stand for what was done before there was a choice. They are
/// left out as lines of the config, so that a key that is new costs nobody a run.
const LATER: [&str; 2] = ["compute = \"f32\"", "relief = true"];

/// Digest of everything in a config that decides the results of a run.
pub fn of_run(config: &Config) -> String {
    let mut deciding = config.clone();
    let defaults = Config::default();
    deciding.run.name.clear();
    deciding.run.data_workers = defaults.run.data_workers;
    // A run that stopped at a NaN may go on with `restore`: the steps before are the same.
    deciding.run.on_nan = defaults.run.on_nan;
    deciding.run.material_cache_mib = defaults.run.material_cache_mib;
    deciding.checkpoint = defaults.checkpoint;
    deciding.report = defaults.report;
    digest(&deciding)
}

/// Digest of what decides the results of one part's stages: where it is the same, two runs train the same nets.
pub fn of_part(config: &Config, part: Part) -> String {
    let mut deciding = config.clone();
    let defaults = Config::default();
    match part {
        Part::Flow => deciding.svbrdf = defaults.svbrdf,
        Part::Svbrdf => {
            (deciding.flow, deciding.chairs) = (defaults.flow, defaults.chairs);
            (deciding.adjacent, deciding.distant) = (defaults.adjacent, defaults.distant);
        }
    }
    of_run(&deciding)
}

fn digest(config: &Config) -> String {
    let text = config.to_toml();
    // Histograms decide nothing of the results.
    let old = |line: &&str| !line.starts_with("histogram_every = ") && !LATER.contains(&line.trim_end());
    let deciding: String = text.split_inclusive('\n').filter(old).collect();
    Sha256::digest(deciding).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where this fails after a key was added, the key belongs into `LATER`: otherwise every run that somebody has under way
    /// can't be resumed. The digest is that of revision 0da0f9f, where a checkpoint confirms the text it is made of.
    #[test]
    fn new_keys_leave_the_checkpoints_of_old_runs_valid() {
        assert_eq!(of_run(&Config::default()), "d69c4ec6d7301f11d1487d86094d3a30f297af69c1e18e83140685437c42902d");
    }

    #[test]
    fn what_decides_the_results_is_in_the_digest_and_what_does_not_is_not() {
        let with = |assignment: &str| {
            let assignments: Vec<String> = vec![assignment.into()];
            of_run(&Config::load("smoke.toml", &assignments).unwrap())
        };
        let plain = with("run.compute=\"f32\"");
        for same in ["run.name=\"other\"", "report.synthetic.align.relief=false", "adjacent.optimisation.histogram_every=3"] {
            assert_eq!(with(same), plain, "{same}");
        }
        for other in ["run.compute=\"f16\"", "run.seed=9", "adjacent.steps=3"] {
            assert_ne!(with(other), plain, "{other}");
        }
    }
}
