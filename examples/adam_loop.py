"""A cup as a module in a training loop: python examples/adam_loop.py"""

import torch

from brafit.cup import StripsCup
from brafit.fitting import ConditionLoss, start_cups
from brafit.run.fitting import target_of
from brafit.scan import load_scan

target = target_of(load_scan("brafit/samples/anny_04.ply"))
cup = StripsCup(target.wire, panels=2)  # or FramesCup
start_cups(cup, [target])
points = torch.as_tensor(target.points)[None]  # (batch, n, 3), in the cup frame, mm
conditions = ConditionLoss(cup, [target])  # neckline, strap point, margin, fairness
adam = torch.optim.Adam(cup.parameters(), betas=(0.9, 0.99))
schedule = torch.optim.lr_scheduler.OneCycleLR(adam, max_lr=0.15, total_steps=300)
for _ in range(300):
    loss = cup(points).square().mean() + conditions().sum()
    adam.zero_grad()
    loss.backward()
    adam.step()
    schedule.step()
print(f"RMS {cup(points).square().mean().sqrt():.2f} mm, least margin {cup.margin().min():.2f}")
print("flat edges, mm:", cup.patterns().lower.shape, cup.patterns().upper.shape)
