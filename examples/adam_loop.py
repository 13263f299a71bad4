"""A cup as a module in a training loop: python examples/adam_loop.py"""

import torch

from brafit.cup import StripsCup
from brafit.fitting import ConditionLoss, start_cups
from brafit.run.fitting import target_of
from brafit.samples import sample_paths
from brafit.scan import load_scan

target = target_of(load_scan(sample_paths()[1]))  # in its cup frame, mm
cup = StripsCup(target.wire, panels=2)  # or FramesCup
start_cups(cup, [target])
conditions = ConditionLoss(cup, [target])  # neckline, strap point, margin, fairness
points = torch.as_tensor(target.points)[None]  # (batch, n, 3)
adam = torch.optim.Adam(cup.parameters(), betas=(0.9, 0.95))
schedule = torch.optim.lr_scheduler.OneCycleLR(adam, max_lr=0.1, total_steps=300)
for step in range(300):
    adam.zero_grad()
    penalty = 0.1 * 1000 ** (step / 300)  # on what FramesCup leaves to the fit: ends, developability
    loss = cup(points).square().mean() + conditions(penalty).sum()
    loss.backward()
    adam.step()
    schedule.step()
    if step % 50 == 0:
        print(f"step {step} of 300: loss {loss.item():.2f} mm²")
print(f"{target.name}: RMS {cup(points).square().mean().sqrt():.3f} mm, least margin {cup.margin().min():.2f}")
flat = cup.patterns()  # flat.lower, flat.upper: (batch, panels, stations, 2), mm, differentiable
