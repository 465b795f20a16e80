# The reproduction of the paper in a container:
#
#   docker build -t exact-mdp .
#   docker run --rm -v "$PWD/results:/src/results" exact-mdp
#
# The build installs the locked packages; the run calls nothing outside.
FROM python:3.11-slim
RUN apt-get update \
 && apt-get install -y --no-install-recommends git make \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
RUN make setup
CMD ["make", "reproduce"]
