//! The size of a net that isn't built yet.

use super::{HEAD, Normalisation, Pooling, SvbrdfNetConfig};
use crate::constants::OUTPUTS;

impl SvbrdfNetConfig {
    /// How many weights the net has.
    pub fn parameters(&self) -> usize {
        let affine = if self.normalisation == Normalisation::Instance { 2 } else { 0 };
        let convolution = |from: usize, to: usize| (9 * from + affine) * to;
        let global = self.global_width();
        let track = |channels: usize, previous: usize| (channels + previous + 1) * global + previous * channels;
        let (encoder, decoder, head) = (self.encoder_widths(), self.decoder_widths(), self.head_widths());
        let level = |i: usize| {
            let from = if i == 0 { self.input_channels() } else { encoder[i - 1] };
            convolution(from, encoder[i]) + track(encoder[i], if i == 0 { 0 } else { global })
        };
        let block = |i: usize| {
            let from = if i == 0 { encoder[self.levels - 1] } else { decoder[i - 1] + encoder[self.levels - 1 - i] };
            convolution(from, decoder[i]) + convolution(decoder[i], decoder[i]) + track(decoder[i], global)
        };
        let layer = |i: usize| {
            let (from, previous) = self.head_inputs(i);
            convolution(from, head[i]) + track(head[i], previous)
        };
        let inputs = head[HEAD.len() - 1] + self.pooled_colours();
        let attention = if self.pooling == Pooling::Attention { self.feature_channels() + 1 + global + 1 } else { 0 };
        let maps = (9 * inputs + 1) * OUTPUTS;
        (0..self.levels).map(|i| level(i) + block(i)).sum::<usize>()
            + (0..HEAD.len()).map(layer).sum::<usize>()
            + attention
            + maps
    }
}
