#!/usr/bin/env bash
# From drives to a report on two cores: `make demo`, or `make demo KITTI=folder` on real drives.
# What is there already is kept, so an interrupted demo goes on where it was.
set -euo pipefail
mkdir -p "${DEMO:=demo}"
if [ -n "${KITTI:-}" ]; then
  drives=$(cd "$KITTI" && pwd)
  cd "$DEMO"
else
  cd "$DEMO"
  drives=drives
  envpred simulate drives --drives 10 --frames 120 --seed 0
fi
envpred grids --source "$drives" --store grids --context 256 --particle_forecast all

common=(--config dst_static --data.store grids --trainer.enable_model_summary false)

fit() { # a model's configuration, the name of its runs; goes on where it stopped, and does nothing if it is finished
  local run=runs/fit/$2/dst_static resume=()
  grep -qs '"ended": [0-9]' "$run"/*/validations.json && return
  [ -n "$(find "$run" -name last.ckpt 2>/dev/null)" ] && resume=(--ckpt_path last)
  envpred fit --config "$1" "${common[@]}" "${resume[@]}"
}
evaluate() { # a model's configuration, options; its result is the newest in its folder
  envpred test --config "$1" "${common[@]}" --trainer.enable_progress_bar false "${@:2}"
}

fit prednet_small prednet
fit fcn_small fcn
fit corrected_rollout_quick corrected_rollout
evaluate prednet_small --ckpt_path best
evaluate fcn_small --ckpt_path best
evaluate corrected_rollout_quick --ckpt_path best
# The baselines compute little, so two at a time, a core each.
export OMP_NUM_THREADS=1
evaluate last_frame & one=$!
evaluate moved_last_frame
wait $one
evaluate moved_last_frame_oracle & one=$!
evaluate particle_forecast
wait $one
evaluate rollout_static

results=()
for model in prednet fcn last_frame moved_last_frame moved_last_frame_oracle particle_forecast rollout \
  corrected_rollout; do
  results+=("$(find runs/test/$model -name result.json | sort -V | tail -1)")
done
envpred report "${results[@]}" --out report
cat report/methods.md
cat <<END

report, with curves, picture strips and animations: $DEMO/report/report.html
error curve:                                        $DEMO/report/error.png
the training:                                       tensorboard --logdir $DEMO/runs/fit
END
