"""
Your own fit in PyTorch
=======================

``phantomgen.torch`` has the model of a scan as differentiable functions. Here Adam fits the values of voxels to counts,
first with the true poses, then with a file that states the panel half a pixel beside its place, and last with this
offset as one more unknown. Run it as one of::

    python examples/plot_torch.py           # 48^3 voxels, three minutes
    python examples/plot_torch.py --quick   # 32^3 voxels, 40 seconds
"""

# sphinx_gallery_thumbnail_path = 'images/torch.png'

import sys
from dataclasses import replace
from pathlib import Path

import torch

import phantomgen
from phantomgen.display.figures.style import BLUE, GRAY, RED, figure_file
from phantomgen.torch import ForwardModel

QUICK = "--quick" in sys.argv[1:]
FOLDER = Path("torch-example")
FOLDER.mkdir(exist_ok=True)

# %%
# Two scans
# ---------
#
# One object, one set of counts, two files: the second one states a panel that lies half a pixel along its columns from
# where it was.

SMALL = ["geometry.views=24", "geometry.test_views=2", "panel={rows: 48, columns: 48, pitch: 4.27}", "volume.voxels=32"]
FULL = ["geometry.views=48", "geometry.test_views=2", "panel={rows: 72, columns: 72, pitch: 2.85}", "volume.voxels=48"]
scan = phantomgen.load("kedge-small", SMALL if QUICK else FULL)
right = phantomgen.make(scan, FOLDER / "right.h5", overwrite=True)
wrong = phantomgen.degrade(right, FOLDER / "wrong.h5", shift=0.5, overwrite=True)
print(right)

# %%
# A fit of a dozen lines
# ----------------------
#
# ``ForwardModel`` turns basis volumes into the counts that a dataset expects. ``torch`` has the likelihood of Poisson
# counts and Adam. Coefficients are in units of typical ones, so that all of them need steps of the same size; they are
# not negative. An offset of the panel is one more parameter.

TYPICAL = torch.tensor([0.01, 0.02, 0.005]).reshape(3, 1, 1, 1)  # photoelectric, Compton, K-edge [1/mm]
EPOCHS, BATCHES = 100, 4


def fit(dataset, find_offset=False):
    model, views = ForwardModel.of(dataset), torch.from_numpy(dataset.splits["train"])
    counts = torch.from_numpy(dataset.load(views)).float()
    voxels = torch.full((3, *dataset.grid.shape), 0.05, requires_grad=True)
    offset = torch.zeros((), dtype=torch.float64, requires_grad=find_offset)  # [pixel]
    optimizer = torch.optim.Adam([{"params": [voxels], "lr": 0.1}, {"params": [offset], "lr": 0.02}])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, EPOCHS * BATCHES)
    order, offsets = torch.Generator().manual_seed(0), [0.0]
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(views), generator=order).chunk(BATCHES):
            moved = replace(model, geometry=model.geometry.shifted(columns=offset))
            expected = moved(TYPICAL * voxels, views[batch])
            loss = torch.nn.functional.poisson_nll_loss(expected, counts[batch], log_input=False)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            with torch.no_grad():
                voxels.clamp_(min=0)
        offsets.append(offset.item())
    return (TYPICAL * voxels).detach(), offsets


fits = {"true poses": fit(right), "panel 0.5 pixel off": fit(wrong), "offset fitted": fit(wrong, find_offset=True)}

# %%
# Against the truth
# -----------------
#
# Only now the truth is opened. The offset that is found takes back what the file states wrongly.

truth = torch.from_numpy(phantomgen.read_truth(right.path).volumes)
scores = {}
for name, (volumes, offsets) in fits.items():
    errors = (volumes - truth).square().mean(dim=(1, 2, 3)).sqrt()
    scores[name] = (20 * torch.log10(truth.amax(dim=(1, 2, 3)) / errors)).tolist()
    print(f"{name:<20} PSNR {' / '.join(f'{score:.2f}' for score in scores[name])} dB, offset {offsets[-1]:+.4f} pixel")
offset_error = fits["offset fitted"][1][-1] + 0.5
print(f"error of the offset: {offset_error:+.4f} pixel")

# %%
# The Compton volume in the middle slice, and the offset from epoch to epoch.

with figure_file(FOLDER / "torch.png", (7.0, 3.9)) as figure:
    above, below = figure.subfigures(2, 1, height_ratios=(1.35, 1))
    images = {"truth": truth, **{name: volumes for name, (volumes, _) in fits.items()}}
    for axes, (name, volumes) in zip(above.subplots(1, 4), images.items(), strict=True):
        axes.imshow(volumes[1, volumes.shape[1] // 2].numpy(), cmap="gray", vmin=0, vmax=float(truth[1].max()))
        axes.set_title(name if name == "truth" else f"{name}\n{scores[name][1]:.1f} dB")
        axes.set_axis_off()
    axes = below.subplots()
    axes.axhline(-0.5, color=GRAY, linewidth=0.8, label="truth")
    for (name, (_, offsets)), colour in zip(list(fits.items())[1:], (RED, BLUE), strict=True):
        axes.plot(offsets, color=colour, label=name)
    axes.set(xlabel="epoch", ylabel="offset [pixel]")
    axes.legend()
for dataset in (right, wrong):
    dataset.close()
print(f"Wrote {FOLDER / 'torch.png'}")
