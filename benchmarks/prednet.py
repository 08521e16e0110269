"""PredNet (4, 48, 96, 192) over windows of 20 grids of 128 x 128 cells against its bare convolutions.

    python -m benchmarks.prednet --threads 2

The promise: forward and training step take at most 1.15 x the time of the bare convolutions alone.  These are all
convolutions of all 20 steps as the network defines them, the four gates of a layer in one, channels last, float32, on
inputs that lie ready, and for the training step each one's gradients of input, kernel and bias; no activation, no
concatenation, no loss, no optimiser.  Ours may be faster than that: it convolves before it upsamples, leaves out what
is known to be zero or reaches no output, and computes a kernel's gradient for all steps at once.

A training step is forward, the loss of stage t+1 (error of the lowest layer over frames 1 to 19), backward, Adam.
Where there is a GPU, the forecasts of one sequence (15 after 5 frames shown) and the training step are timed on it too.
"""

import argparse
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from benchmarks.timing import medians, print_table
from envpred.networks.prednet import PredNet, Unrolled

CHANNELS, STEPS, GIVEN, CELLS = (4, 48, 96, 192), 20, 5, 128
PROMISE, GPU_PROMISE_MS = 1.15, 20
Unroll = Callable[..., Unrolled]


class BareConvolutions:
    """The convolutions of a PredNet, alone."""

    def __init__(self, network: PredNet) -> None:
        self.work = []
        for layer, parts in enumerate(zip(network.gates, network.predict, (*network.target, None), strict=True)):
            for convolution in filter(None, parts):
                weight, bias = convolution.weight.detach(), convolution.bias
                assert bias is not None
                side = CELLS >> layer
                inputs, deltas = (
                    torch.rand(1, channels, side, side).to(memory_format=torch.channels_last)
                    for channels in (convolution.in_channels, convolution.out_channels)
                )
                self.work.append((inputs, weight, bias.detach(), deltas))

    def forward(self) -> None:
        for _ in range(STEPS):
            for inputs, weight, bias, _ in self.work:
                torch.nn.functional.conv2d(inputs, weight, bias, padding=1)

    def train(self) -> None:
        self.forward()
        for _ in range(STEPS):
            for inputs, weight, bias, deltas in self.work:
                torch.ops.aten.convolution_backward(
                    deltas, inputs, weight, [len(bias)], [1, 1], [1, 1], [1, 1], False, [0, 0], 1, [True, True, True]
                )


def forward(unroll: Unroll, frames: Tensor) -> None:
    with torch.inference_mode():
        unroll(frames, error_layers=0)


def train(unroll: Unroll, frames: Tensor, optimizer: torch.optim.Optimizer, dtype: torch.dtype = torch.float32) -> None:
    """One training step on the loss of stage t+1."""
    optimizer.zero_grad()
    with torch.autocast(frames.device.type, dtype, enabled=dtype != torch.float32):
        loss = unroll(frames, error_layers=1).errors[:, 1:].mean()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()


def on_cpu(repeats: int) -> None:
    network, frames = PredNet(CHANNELS), torch.rand(1, STEPS, CHANNELS[0], CELLS, CELLS)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-4)
    bare = BareConvolutions(network)
    rows = []
    for task, run, floor in (
        ("forward", forward, bare.forward),
        ("training step", partial(train, optimizer=optimizer), bare.train),
    ):
        ours, plain = partial(run, network.unroll, frames), partial(run, network.unroll_by_steps, frames)
        seconds = medians({"ours": ours, "bare": floor, "plain": plain}, repeats)
        rows.append([task, *(f"{seconds[name]:.2f} s" for name in seconds), f"{seconds['ours'] / seconds['bare']:.2f}"])
    print(
        f"\nCPU, {torch.get_num_threads()} threads, float32, batch 1, medians of {repeats}; promised ratio {PROMISE}\n"
    )
    print_table(["", "ours", "bare convolutions", "step by step, autograd", "ours / bare"], rows)


def by_compiled_steps(network: PredNet) -> Unroll:
    """The window as compiled steps: one step compiles in a minute or two, 20 of them as one graph in many."""
    torch.compiler.reset()  # or the variants of earlier tables count against its limit of recompilations
    step = torch.compile(network.step, dynamic=False)

    def unroll(frames: Tensor, given: int = STEPS, steps: int = STEPS, error_layers: int = 0) -> Unrolled:
        state = network.initial_state(len(frames), CELLS, CELLS)
        predictions = [state.prediction]
        for t in range(steps - 1):
            _, state = step(frames[:, t] if t < given else None, state)
            predictions.append(state.prediction)
        stacked = torch.stack(predictions, 1)
        return Unrolled(
            stacked, 0.5 * (stacked - frames).abs().mean(dim=(2, 3, 4))[..., None] if error_layers else stacked
        )

    return unroll


def replayed(call: Callable[[], object]) -> Callable[[], object]:
    """`call` recorded as a CUDA graph: its kernels without the time that Python needs to start them."""
    stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        call()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        call()
    return graph.replay


def forecasts_on_gpu(network: PredNet, repeats: int) -> None:
    """The forecasts of one sequence."""
    shown = torch.rand(1, GIVEN, CHANNELS[0], CELLS, CELLS, device="cuda")
    rows = []
    for dtype in (torch.float32, torch.bfloat16):

        def forecasts(unroll: Unroll, dtype: torch.dtype = dtype) -> None:
            with torch.no_grad(), torch.autocast("cuda", dtype, enabled=dtype != torch.float32):
                unroll(shown, GIVEN, STEPS, error_layers=0)

        eager = partial(forecasts, network.unroll)
        compiled = partial(forecasts, by_compiled_steps(network))
        work: dict[str, Callable[[], object]]
        work = {"eager": eager, "CUDA graph": replayed(eager), "compiled steps": compiled}
        seconds = medians(work, repeats, torch.cuda.synchronize)
        rows.append([f"15 forecasts, {dtype}".replace("torch.", ""), *(f"{1000 * s:.1f} ms" for s in seconds.values())])
    print(f"\n{torch.cuda.get_device_name()}, medians of {repeats}; promised for 15 forecasts: {GPU_PROMISE_MS} ms\n")
    print_table(["", "eager", "CUDA graph", "compiled steps"], rows)


def training_on_gpu(network: PredNet, repeats: int) -> None:
    """The training step by batch, precision and compilation."""
    rows = []
    for batch in (1, 8, 32):
        frames = torch.rand(batch, STEPS, CHANNELS[0], CELLS, CELLS, device="cuda")
        for dtype in (torch.float32, torch.bfloat16):
            step = partial(train, frames=frames, optimizer=torch.optim.Adam(network.parameters(), lr=1e-4), dtype=dtype)
            torch.cuda.reset_peak_memory_stats()
            step(network.unroll)
            memory = torch.cuda.max_memory_allocated() / 2**30
            work = {"eager": partial(step, network.unroll), "compiled": partial(step, by_compiled_steps(network))}
            seconds = medians(work, repeats, torch.cuda.synchronize)
            times = (f"{1000 * s:.0f} ms" for s in seconds.values())
            rows.append([f"training step, batch {batch}, {dtype}".replace("torch.", ""), *times, f"{memory:.1f} GiB"])
    print()
    print_table(["", "eager", "compiled steps", "eager's memory"], rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(0)
    print(f"torch {torch.__version__}, PredNet {CHANNELS}, {STEPS} steps of {CELLS} x {CELLS} cells")
    on_cpu(arguments.repeats)
    if torch.cuda.is_available():
        network = PredNet(CHANNELS).cuda()
        forecasts_on_gpu(network, 10 * arguments.repeats)
        training_on_gpu(network, 10 * arguments.repeats)


if __name__ == "__main__":
    main()
