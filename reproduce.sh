#!/bin/sh
# Everything of the paper, from nothing: the same as `make reproduce`.
set -e
cd "$(dirname "$0")"
exec make reproduce "$@"
