//! The learning rate at a step.

use crate::config::{Optimisation, Schedule};

/// One-cycle starts at this share of the peak.
const ONE_CYCLE_START: f64 = 0.1;

/// The learning rate of step `step` (from 0) of `steps`.
pub fn rate(plan: &Optimisation, step: usize, steps: usize) -> f64 {
    let warm_up = plan.warm_up.min(steps);
    let ramp = if warm_up == 0 { 1.0 } else { (step as f64 + 1.0) / warm_up as f64 };
    let share = match plan.schedule {
        Schedule::Constant => ramp.min(1.0),
        Schedule::OneCycle if step < warm_up => ONE_CYCLE_START + (1.0 - ONE_CYCLE_START) * ramp,
        Schedule::OneCycle => {
            let rest = (steps - warm_up).max(1) as f64;
            let done = (step - warm_up) as f64 / rest;
            0.5 * (1.0 + (std::f64::consts::PI * done.min(1.0)).cos())
        }
    };
    plan.learning_rate * share
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(schedule: Schedule) -> Optimisation {
        Optimisation { learning_rate: 2.0, schedule, warm_up: 10, ..Optimisation::default() }
    }

    #[test]
    fn constant_ramps_linearly_and_stays() {
        let plan = plan(Schedule::Constant);
        assert_eq!(rate(&plan, 0, 100), 0.2);
        assert_eq!(rate(&plan, 9, 100), 2.0);
        assert_eq!(rate(&plan, 99, 100), 2.0);
    }

    #[test]
    fn one_cycle_peaks_after_the_ramp_and_ends_near_zero() {
        let plan = plan(Schedule::OneCycle);
        assert_eq!(rate(&plan, 9, 100), 2.0);
        assert_eq!(rate(&plan, 10, 100), 2.0);
        assert!((rate(&plan, 55, 100) - 1.0).abs() < 1e-12);
        assert!(rate(&plan, 99, 100) < 0.01);
        assert!((10..99).all(|step| rate(&plan, step + 1, 100) < rate(&plan, step, 100)));
    }

    #[test]
    fn a_ramp_longer_than_the_stage_still_reaches_the_peak() {
        assert_eq!(rate(&plan(Schedule::Constant), 4, 5), 2.0);
        assert_eq!(rate(&plan(Schedule::OneCycle), 4, 5), 2.0);
    }
}
