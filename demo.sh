#!/usr/bin/env bash
# From drives to a report on two cores: `make demo`, or `make demo KITTI=folder` on real drives.
# What is there already is kept, so an interrupted demo goes on where it was.
set -euo pipefail
repository=$(cd "$(dirname "$0")" && pwd)
mkdir -p "${DEMO:=demo}"
if [ -n "${KITTI:-}" ]; then
  source=$(cd "$KITTI" && pwd)
  cd "$DEMO"
else
  cd "$DEMO"
  source=drives
  [ -d drives ] || envpred simulate drives --drives 10 --frames 120 --seed 0
fi
grids=grids
runs=runs
envpred grids --source "$source" --store $grids --particle_forecast '[all]'
quiet="--data.store $grids --trainer.enable_model_summary false"
configs=$repository/configs
common="--config $configs/data/dst_static.yaml $quiet"
if [ ! -f $runs/prednet/dst_static/version_0/checkpoints/best.ckpt ]; then
  # shellcheck disable=SC2086
  envpred fit --config "$configs/model/prednet_small.yaml" $common
fi
# shellcheck disable=SC2086
envpred test --config "$configs/model/prednet_small.yaml" $common --ckpt_path best
for baseline in last_frame moved_last_frame moved_last_frame_oracle particle_forecast; do
  # shellcheck disable=SC2086
  envpred test --config "$configs/model/$baseline.yaml" $common
done
results=()
for model in prednet last_frame moved_last_frame moved_last_frame_oracle particle_forecast; do
  results+=("$(find $runs/$model -name result.json | sort -V | tail -1)")
done
envpred report "${results[@]}" --out report
cat report/methods.md
echo "tables, curves and pictures: $DEMO/report/report.html"
echo "the training: tensorboard --logdir $DEMO/$runs"
