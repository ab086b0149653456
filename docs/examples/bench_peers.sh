#!/usr/bin/env bash
# Fetch the files of SpatialRGPT and VQASynth whose functions `spatialviz bench --peers FOLDER` times.
# They are not part of this project and keep their own licences (Apache-2.0 both; see their repositories).
set -euo pipefail
folder=${1:?usage: bench_peers.sh FOLDER}

fetch() { # REPOSITORY COMMIT DIRECTORY FILES...
    repository=$1 commit=$2 directory=$3
    shift 3
    for file in "$@"; do
        mkdir -p "$folder/$directory/$(dirname "$file")"
        curl -fsSL "https://raw.githubusercontent.com/$repository/$commit/$file" -o "$folder/$directory/$file"
    done
}

fetch AnjieCheng/SpatialRGPT 16715d4f1419997da18926c6ce574802d1eb3a37 SpatialRGPT \
    dataset_pipeline/osdsynth/processor/pointcloud.py dataset_pipeline/osdsynth/processor/prompt.py \
    dataset_pipeline/osdsynth/processor/prompt_template.py dataset_pipeline/osdsynth/processor/prompt_utils.py
fetch remyxai/VQASynth 4a4dc1b12e901a95f27ba092f7244304ea236709 VQASynth \
    vqasynth/scene_fusion.py vqasynth/prompts.py vqasynth/prompt_templates.py
echo "pip install 'spatialviz[open3d]' && spatialviz bench --only lift --peers $folder"
