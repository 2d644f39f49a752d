# `make test` and `make reproduce` need Python 3.11, pip and make; both create .venv and reuse it.
PYTHON ?= python3
# Where the package index holds GPU builds of torch only, name the CPU one:
# TORCH="torch==2.13.0 --index-url https://download.pytorch.org/whl/cpu"
TORCH ?= torch==2.13.0
BIN := .venv/bin
OUT ?= results/section3
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
SITE = $(shell cd .venv && echo lib/python3.*/site-packages)
BENCHMARL := benchmarl==1.5.2 torchrl==0.11.1 tensordict==0.11.0
NEVER_IMPORTED := /(tests?|_inductor|torch/testing|sqlalchemy|debugpy|fontTools|pygments|setuptools)/
LOADED_FROM_ELSEWHERE := <(script|img|iframe|source)[^>]* src="(https?:)?//|<link[^>]* href="(https?:)?//[^>]*stylesheet|stylesheet"[^>]* href="(https?:)?//|url\([^)]?(https?:)?//
PACKAGE_FOLDERS := $(shell find coopmap coopmap_env baselines agents -type d -not -name __pycache__)

SEEDS := 0 1 2
MAP_SEEDS := 0
# How each policy that ships is trained, beside its seed.
planar-candidates := --engine sb3 --validation-episodes 100
planar-candidates-rating := --engine sb3 --reward rating --ppo.initial-policy rating \
	--validation-episodes 100
planar-pose := --engine sb3 --action-mode pose --ppo.total-steps 524288 \
	--ppo.segment-steps 65536 --validation-episodes 60
field-candidates := --engine sb3 --env field --ppo.initial-policy rating --ppo.total-steps 24576 \
	--ppo.segment-steps 4096 --ppo.n-envs 4 --ppo.batch-size 128 --validation-episodes 12
POLICIES := planar-candidates planar-candidates-rating planar-pose field-candidates

# Where this is set, every program that tests start would compile all modules again.
export PYTHONDONTWRITEBYTECODE :=

# Plays an episode in each action mode and with planners, in the environments of some ids.
PLAY := PYTHONPATH=tests $(BIN)/python -P -m plain.golden 1

.PHONY: setup check kernels docs benchmarl test speed reproduce policies $(POLICIES) map-networks planners leaderboard \
	engines pictures clean

setup: .venv/.package

# torch comes first and pinned: asked for later, another package would pull its GPU build.
# Files are compiled at the end, on all processors; pip would use one. Templates among them fail.
# More than a third of the code is never imported: Python would compile it when it is.
.venv/.dependencies: pyproject.toml setup.py constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(PIP) $(TORCH)
	$(PIP) --editable ".[dev]" --config-settings editable_mode=strict
	$(BIN)/python -W ignore -m compileall -qq -j 0 -x '$(NEVER_IMPORTED)' .venv/lib || true
	touch $@

# A strict editable install links single files, so it is renewed when a folder gains or loses one;
# it lets type checkers see `baselines` and `agents` under their installed names.
.venv/.package: .venv/.dependencies $(PACKAGE_FOLDERS)
	$(PIP) --no-deps --editable . --config-settings editable_mode=strict
	touch $@

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Numba compiles for minutes on a new machine. Here it is done once; in the tests it would be done by
# each of the processes that start first.
kernels: setup
	$(PLAY) coopmap/Planar-v1 > /dev/null & \
		$(PLAY) coopmap/Field-v1 coopmap/FieldSearch-v1 > /dev/null & wait

# The site, in build/docs. Warnings are errors, nothing may be loaded from elsewhere, and a table that
# is no table stays a paragraph with bars.
docs: setup
	$(BIN)/python -P -m sphinx --fresh-env --jobs auto --fail-on-warning --keep-going --quiet \
		--doctree-dir build/doctrees docs build/docs
	! grep -rlE '$(LOADED_FROM_ELSEWHERE)' --include='*.html' --include='*.css' build/docs
	! grep -rl '<p>|' --include='*.html' build/docs

# `python -m pytest` would import from this folder, and the programs that tests start from the
# installed links: numba would compile all kernels for both.
test: setup
	$(MAKE) --no-print-directory --jobs 2 check kernels
	$(MAKE) --no-print-directory docs
	$(BIN)/pytest --numprocesses auto --dist worksteal
	$(MAKE) --no-print-directory benchmarl
	$(MAKE) --no-print-directory speed

# BenchMARL needs a TorchRL before 0.12: it has an environment of its own, on top of the other.
benchmarl: setup
	$(BIN)/python -m venv --without-pip .venv/benchmarl
	echo "import site; site.addsitedir('$(CURDIR)/.venv/$(SITE)')" > .venv/benchmarl/$(SITE)/above.pth
	test -d .venv/benchmarl/$(SITE)/benchmarl || $(BIN)/python -m pip install --quiet --no-compile \
		--disable-pip-version-check --no-deps --target .venv/benchmarl/$(SITE) $(BENCHMARL)
	.venv/benchmarl/bin/python -P -m pytest tests/agents/test_benchmarl.py \
		'tests/test_examples.py::test_an_example_runs_without_a_warning[benchmarl_mappo]'

# Steps of this version and of the last commit shared with main, in turns; it decides nothing.
speed: setup
	-$(BIN)/python -P -m coopmap_env.studies.speed.regression

reproduce: setup
	$(BIN)/coopmap reproduce --quick --out $(OUT)

# The pretrained policies, trained again: about two hours on one core. `make planar-pose` is one.
policies: $(POLICIES)
	$(BIN)/python -m coopmap_env.studies.benchmark.learning_curves docs/learning_curves.png

$(POLICIES): setup
	for seed in $(SEEDS); do \
		OMP_NUM_THREADS=1 $(BIN)/coopmap train --out results/$@/$$seed --seed $$seed $($@) || exit 1; \
	done
	$(BIN)/python -m coopmap_agents.pretrained.export agents/pretrained/policies/$@ $(addprefix results/$@/,$(SEEDS))

# The networks that predict maps, trained again: one to two hours on one core for each seed.
map-networks: setup
	for env in planar field; do for seed in $(MAP_SEEDS); do \
		OMP_NUM_THREADS=1 $(BIN)/coopmap train-map --env-name $$env --seed $$seed \
			--out results/map-$$env/$$seed || exit 1; \
	done; done
	$(BIN)/python -m coopmap_agents.map_prediction.export agents/map_prediction/models \
		$(addprefix results/map-planar/,$(MAP_SEEDS)) $(addprefix results/map-field/,$(MAP_SEEDS))

# The strongest planners by training worlds, which `coopmap compare` plays against.
planners: setup
	$(BIN)/python -m coopmap_env.studies.benchmark.tuning results/planner-tuning --workers 2
	cp results/planner-tuning/tuned_planners.json coopmap_env/studies/benchmark/

# The project's own entries on the leaderboard, as far as they are missing, and its page.
leaderboard: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m coopmap_env.studies.leaderboard docs/leaderboard
	$(BIN)/coopmap score docs/leaderboard --page docs/leaderboard/index.html --tables docs/leaderboard/tables.md

# Speed of both engines of training, and their scores after equally long trainings.
engines: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m coopmap_env.studies.engine_comparison results/engines --seeds $(SEEDS)

# The pictures of the site, from the full runs.
pictures: setup
	$(BIN)/coopmap reproduce --out results/section3-full --workers 2
	cp $(addprefix results/section3-full/,figure7.png figure8.png render.png field_surface.png) docs/
	cp results/section3-full/field_render.png docs/field.png
	$(BIN)/coopmap localization --out results/localization --workers 2
	cp results/localization/search.png docs/localization_search.png
	cp results/localization/errors.png docs/localization_errors.png
	cp results/localization/episode.png docs/localization_episode.png
	$(BIN)/coopmap compare --out results/comparison --workers 2
	cp results/comparison/planar.png docs/policies_planar.png
	cp results/comparison/field.png docs/policies_field.png
	cp results/comparison/generalization.png docs/policies_generalization.png
	cp results/comparison/motion_planar.png docs/policies_motion_planar.png
	cp results/comparison/motion_field.png docs/policies_motion_field.png

clean:
	rm -rf .venv build *.egg-info .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
