//! Linear colours, palettes and the reflectances of metals.

use super::field::lerp;

/// A linear RGB triple.
pub type Rgb = [f32; 3];

/// The linear value of an 8-bit sRGB colour, as a colour picker shows it.
pub fn srgb(red: u8, green: u8, blue: u8) -> Rgb {
    [red, green, blue].map(|v| ops::colour::srgb_to_linear(v as f32 / 255.0))
}

/// The linear value of a gamma-encoded colour given as hue in turns, saturation and value.
pub fn hsv(hue: f32, saturation: f32, value: f32) -> Rgb {
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|shift| {
        let k = (hue + shift).rem_euclid(1.0) * 6.0;
        let ramp = ((k - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        ops::colour::srgb_to_linear(value * lerp(1.0, ramp, saturation))
    })
}

/// Linear interpolation from `a` to `b`.
#[inline]
pub fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    [lerp(a[0], b[0], t), lerp(a[1], b[1], t), lerp(a[2], b[2], t)]
}

/// All channels times `factor`.
#[inline]
pub fn scale(colour: Rgb, factor: f32) -> Rgb {
    colour.map(|v| v * factor)
}

/// Evenly spaced colours with linear interpolation between them.
#[derive(Clone, Debug)]
pub struct Ramp(pub Vec<Rgb>);

impl Ramp {
    /// The colour at `t`, clamped to [0, 1].
    #[inline]
    pub fn at(&self, t: f32) -> Rgb {
        let position = t.clamp(0.0, 1.0) * (self.0.len() - 1) as f32;
        let below = (position as usize).min(self.0.len().saturating_sub(2));
        let above = (below + 1).min(self.0.len() - 1);
        mix(self.0[below], self.0[above], position - below as f32)
    }
}

/// Linear reflectance at normal incidence.
///
/// # Source
/// Measured indices as tabulated for real-time rendering (Akenine-Möller et al., Real-Time Rendering, 4th ed., table 9.2).
pub mod metal {
    use super::Rgb;
    /// Iron and steel.
    pub const IRON: Rgb = [0.531, 0.512, 0.496];
    /// Copper.
    pub const COPPER: Rgb = [0.955, 0.638, 0.538];
    /// Gold.
    pub const GOLD: Rgb = [1.0, 0.766, 0.336];
    /// Brass.
    pub const BRASS: Rgb = [0.910, 0.778, 0.423];
    /// Bronze.
    pub const BRONZE: Rgb = [0.714, 0.480, 0.270];
    /// Aluminium.
    pub const ALUMINIUM: Rgb = [0.912, 0.914, 0.920];
    /// Silver.
    pub const SILVER: Rgb = [0.972, 0.960, 0.915];
    /// Titanium.
    pub const TITANIUM: Rgb = [0.542, 0.497, 0.449];
    /// Chromium.
    pub const CHROMIUM: Rgb = [0.549, 0.556, 0.554];
    /// Zinc.
    pub const ZINC: Rgb = [0.664, 0.824, 0.850];
    /// Lead, tin and other dull greys.
    pub const LEAD: Rgb = [0.350, 0.352, 0.365];
    /// All of the above.
    pub const ALL: [Rgb; 11] = [IRON, COPPER, GOLD, BRASS, BRONZE, ALUMINIUM, SILVER, TITANIUM, CHROMIUM, ZINC, LEAD];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pickers_and_hues_agree_on_the_primaries() {
        for (hue, rgb) in [(0.0, [255, 0, 0]), (1.0 / 3.0, [0, 255, 0]), (2.0 / 3.0, [0, 0, 255]), (1.0, [255, 0, 0])] {
            let (a, b) = (hsv(hue, 1.0, 1.0), srgb(rgb[0], rgb[1], rgb[2]));
            assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-4), "{hue}: {a:?} {b:?}");
        }
        assert!(hsv(0.3, 0.0, 0.5).iter().all(|v| (v - 0.214).abs() < 1e-3));
    }

    #[test]
    fn ramps_hit_their_stops_and_clamp() {
        let ramp = Ramp(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(ramp.at(-1.0), [0.0; 3]);
        assert_eq!(ramp.at(0.5), [1.0, 0.0, 0.0]);
        assert_eq!(ramp.at(3.0), [0.0, 1.0, 0.0]);
        assert_eq!(ramp.at(0.25), [0.5, 0.0, 0.0]);
        assert_eq!(Ramp(vec![[0.3; 3]]).at(0.9), [0.3; 3]);
    }
}
