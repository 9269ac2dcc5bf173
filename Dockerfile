# clbvh on the host device:  docker build -t clbvh .  &&  docker run -v "$PWD:/data" clbvh render demo -o demo.png
FROM python:3.12-slim
COPY . /source
# All levels: the image may move to another processor.
RUN CLBVH_HOST_TARGET=own pip install --no-cache-dir /source && rm -r /source
# A user without a home can write there, too.
ENV CLBVH_CACHE=/cache XDG_CACHE_HOME=/cache
RUN mkdir -m 777 /cache /data
WORKDIR /data
ENTRYPOINT ["clbvh"]
CMD ["devices"]
