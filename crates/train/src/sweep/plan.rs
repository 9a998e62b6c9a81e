//! The runs of a sweep in the order in which they can be run, and who trains what they share.

use super::file::Member;
use crate::config::Config;
use crate::fingerprint;
use crate::pipeline::Part;

/// One run.
#[derive(Debug, Clone)]
pub struct Run {
    /// Name of its folder.
    pub name: String,
    /// The row of the table.
    pub row: String,
    /// The seed.
    pub seed: u64,
    /// The resolved config.
    pub config: Config,
    /// Earlier runs, by index, whose nets it takes instead of training the same ones again.
    pub takes: Vec<usize>,
}

impl Run {
    /// What it trains itself, for people.
    pub fn trains(&self, all: &[Self]) -> String {
        let taken = |part: &Part| self.takes.iter().any(|&i| same(&all[i].config, &self.config, *part));
        let stages: Vec<&str> =
            Part::ALL.into_iter().filter(|part| !taken(part)).flat_map(|part| part.trained(&self.config)).collect();
        if stages.is_empty() { "nothing".into() } else { stages.join(", ") }
    }
}

/// Runs seed by seed, so that a sweep that is stopped early has whole tables of fewer seeds.
pub fn plan(members: &[Member]) -> Vec<Run> {
    let mut seeds: Vec<u64> = Vec::new();
    for member in members {
        if !seeds.contains(&member.seed) {
            seeds.push(member.seed);
        }
    }
    let mut runs: Vec<Run> = Vec::new();
    for member in seeds.iter().flat_map(|seed| members.iter().filter(move |member| member.seed == *seed)) {
        let owner = |part: Part| {
            let trains = !part.trained(&member.config).is_empty();
            trains.then(|| runs.iter().position(|run| same(&run.config, &member.config, part))).flatten()
        };
        let mut takes: Vec<usize> = Part::ALL.into_iter().filter_map(owner).collect();
        takes.dedup();
        let Member { row, seed, config } = member.clone();
        runs.push(Run { name: config.run.name.clone(), row, seed, config, takes });
    }
    runs
}

fn same(a: &Config, b: &Config, part: Part) -> bool {
    fingerprint::of_part(a, part) == fingerprint::of_part(b, part)
}

/// Runs by how many others they wait for in a row: the first can start at once, the second after the first, and so on.
pub fn levels(runs: &[Run]) -> Vec<Vec<usize>> {
    let mut level = Vec::with_capacity(runs.len());
    for run in runs {
        level.push(run.takes.iter().map(|&other: &usize| level[other] + 1).max().unwrap_or(0));
    }
    let deepest = level.iter().max().map_or(0, |&deepest: &usize| deepest + 1);
    (0..deepest).map(|wanted| (0..runs.len()).filter(|&i| level[i] == wanted).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn member(row: &str, seed: u64, set: &[&str]) -> Member {
        let mut set: Vec<String> = set.iter().map(ToString::to_string).collect();
        set.extend([format!("run.seed={seed}"), format!("run.name={row}-seed{seed}")]);
        Member { row: row.into(), seed, config: Config::load("smoke", &set).unwrap() }
    }

    fn members() -> Vec<Member> {
        let rows: [(&str, &[&str]); 4] = [
            ("full", &[]),
            ("bare", &["svbrdf.loss.weights.top=0.0"]),
            ("unregular", &["report.synthetic.align.regularise=none"]),
            ("flow", &["adjacent.batch=1"]),
        ];
        rows.iter().flat_map(|(row, set)| [1, 2].map(|seed| member(row, seed, set))).collect()
    }

    #[test]
    fn what_would_come_out_the_same_is_trained_once_per_seed() {
        let runs = plan(&members());
        let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
        assert_eq!(names[..5], ["full-seed1", "bare-seed1", "unregular-seed1", "flow-seed1", "full-seed2"]);
        let takes: Vec<&[usize]> = runs.iter().map(|run| run.takes.as_slice()).collect();
        assert_eq!(takes, [&[] as &[usize], &[0], &[0], &[0], &[], &[4], &[4], &[4]]);
        let trains: Vec<String> = runs[..4].iter().map(|run| run.trains(&runs)).collect();
        assert_eq!(trains, ["adjacent, distant, svbrdf", "svbrdf", "nothing", "adjacent, distant"]);
        assert_eq!(levels(&runs), [vec![0, 4], vec![1, 2, 3, 5, 6, 7]]);
    }
}
