//! The maps a frame sees: what the SVBRDF net has to predict from it.

use ops::kernel::vectorise::vectorised;
use ops::planes::Planes;
use rayon::prelude::*;
use render::block::{LANES, TexelBlock};
use render::svbrdf::{CHANNELS, SvbrdfImage};

use super::{ByRow, Sequence, View};

impl Sequence {
    /// The maps that a frame sees pixel by pixel, through its lens and shutter; normals in the frame's axes (x right, y up, z to
    /// the camera) at its middle.
    pub fn target_maps(&self, frame: usize, res: usize) -> SvbrdfImage {
        let (geometry, rotation) = (self.geometry(frame, res), self.camera(frame).normal_to_camera());
        let views = ByRow::new(&geometry, |delay| View::new(&geometry.camera(delay), res));
        let [mut normal, mut diffuse, mut roughness, mut specular] =
            [3, 3, 1, 3].map(|channels| Planes::new(channels, res, res));
        let mut rows: Vec<Vec<&mut [f32]>> = (0..res).map(|_| Vec::with_capacity(CHANNELS)).collect();
        for planes in [&mut normal, &mut diffuse, &mut roughness, &mut specular] {
            for (i, row) in planes.data.chunks_exact_mut(res).enumerate() {
                rows[i % res].push(row);
            }
        }
        rows.into_par_iter().enumerate().for_each(|(y, mut out)| {
            let view = views.at(y);
            vectorised(
                #[inline(always)]
                || {
                    for first in (0..res).step_by(LANES) {
                        let columns = std::array::from_fn(|k| (first + k).min(res - 1) as f64);
                        let pixels = geometry.lens.undistort_block([&columns, &[y as f64; LANES]]);
                        let seen = view.block(&pixels);
                        let TexelBlock { normal, diffuse, roughness, specular } =
                            self.surface.sample_block(&seen.tx, &seen.ty, &seen.footprint);
                        let turned = rotation.map(|axis| {
                            let mut lane = [0.0; LANES];
                            for k in 0..LANES {
                                lane[k] = normal[0][k] * axis[0] + normal[1][k] * axis[1] + normal[2][k] * axis[2];
                            }
                            lane
                        });
                        let used = LANES.min(res - first);
                        let lanes = turned.iter().chain(&diffuse).chain([&roughness]).chain(&specular);
                        for (lane, out) in lanes.zip(&mut out) {
                            out[first..first + used].copy_from_slice(&lane[..used]);
                        }
                    }
                },
            );
        });
        SvbrdfImage { normal, diffuse, roughness, specular }
    }
}

#[cfg(test)]
mod tests {
    use crate::sequence::SequenceConfig;
    use crate::sequence::tests::{cast, sequence};
    use ops::flow_field::warp_planes;
    use ops::planes::Planes;

    #[test]
    fn target_maps_are_the_samples_that_cast_rays_hit_with_normals_in_the_frames_axes() {
        let res = 48;
        let video = sequence(&SequenceConfig::svbrdf(), 1);
        let camera = video.camera(70);
        let maps = video.target_maps(70, res);
        for (y, x) in (0..res * res).map(|i| (i / res, i % res)) {
            let at = |x: f64, y: f64| {
                let [wx, wy] = cast(camera, x, y, res);
                [(wx + 1.0) * 2048.0 - 0.5, (1.0 - wy) * 2048.0 - 0.5]
            };
            let ([tx, ty], [tx1, ty1], [tx2, ty2]) = {
                let (x, y) = (x as f64, y as f64);
                (at(x, y), at(x + 1.0, y), at(x, y + 1.0))
            };
            let footprint = ((tx1 - tx) * (ty2 - ty) - (ty1 - ty) * (tx2 - tx)).abs().sqrt();
            let texel = video.surface().sample(tx as f32, ty as f32, footprint as f32);
            for c in 0..3 {
                assert!((maps.diffuse.at(c, y, x) - texel.diffuse[c]).abs() < 1e-3);
                assert!((maps.specular.at(c, y, x) - texel.specular[c]).abs() < 1e-3);
            }
            assert!((maps.roughness.at(0, y, x) - texel.roughness).abs() < 1e-3);
            let [right, up, back] =
                [camera.right, camera.down.map(|v| -v), camera.forward.map(|v| -v)].map(|axis| axis.map(|v| v as f32));
            for (c, axis) in [right, up, back].iter().enumerate() {
                let expected: f32 = (0..3).map(|k| axis[k] * texel.normal[k]).sum();
                assert!((maps.normal.at(c, y, x) - expected).abs() < 2e-3);
            }
            let length: f32 = (0..3).map(|c| maps.normal.at(c, y, x).powi(2)).sum();
            assert!((length - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn warping_the_source_albedo_by_the_flow_gives_the_targets() {
        let res = 96;
        let video = sequence(&SequenceConfig::flow(), 7);
        let (flow, valid) = video.flow(10, 11, res);
        let (target, source) = (video.target_maps(10, res).diffuse, video.target_maps(11, res).diffuse);
        let error = |image: &Planes| {
            let pixels: Vec<usize> = (0..res * res).filter(|&i| valid.data[i]).collect();
            assert!(pixels.len() > res * res / 2);
            pixels.iter().map(|&i| (image.data[i] - target.data[i]).abs()).sum::<f32>() / pixels.len() as f32
        };
        let (warped, _) = warp_planes(&source, &flow);
        assert!(error(&warped) < 0.1 * error(&source), "{} warped, {} as it is", error(&warped), error(&source));
    }
}
