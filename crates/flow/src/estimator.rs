//! A trained net as the alignment sees it: planes in, flow out.

use burn::module::Module;
use ops::planes::Planes;

use crate::align::FlowEstimator;
use crate::pwc::Pwc;

/// Pairs that go through the net at once: enough to fill the processor, few enough for little memory.
const BATCH: usize = 4;

impl FlowEstimator for Pwc {
    fn flow(&self, first: &Planes, second: &Planes) -> Planes {
        self.flows(&[(first, second)]).remove(0)
    }

    fn flows(&self, pairs: &[(&Planes, &Planes)]) -> Vec<Planes> {
        let device = self.devices().into_iter().next().expect("a net has parameters");
        let batch = |pairs: &[(&Planes, &Planes)]| {
            let (first, second): (Vec<&Planes>, Vec<&Planes>) = pairs.iter().copied().unzip();
            let flow = self.flow(Planes::batch(&first, &device), Planes::batch(&second, &device));
            Planes::from_tensor(flow)
        };
        pairs.chunks(BATCH).flat_map(batch).collect()
    }
}
