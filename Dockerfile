# clbvh with PoCL, a driver for the CPU:  docker build -t clbvh .  &&  docker run -v "$PWD:/data" clbvh render demo -o demo.png
FROM python:3.12-slim
# PoCL 3.0 links every kernel: with `ld`, gcc's libgcc and libc's development files, which gcc brings.
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
COPY . /source
RUN pip install --no-cache-dir /source && rm -r /source
# Kernels and machine code that the container compiles stay in it; a user without a home can write there, too.
ENV CLBVH_CACHE=/cache XDG_CACHE_HOME=/cache
RUN mkdir -m 777 /cache /data && clbvh warmup && chmod -R a+rwX /cache
WORKDIR /data
ENTRYPOINT ["clbvh"]
CMD ["devices"]
