"""Runs an experiment on a photoneye server over gRPC and returns its counts and cones.

Needs: pip install grpcio grpcio-tools numpy pyarrow
"""

import io
import json
import os
import pathlib
import sys
import uuid
import warnings

import grpc
import numpy
import pyarrow.ipc
from google.protobuf import json_format

# Message and service classes are made from the .proto files when this module is loaded.
PROTO = pathlib.Path(__file__).resolve().parents[2] / "proto"
sys.path.insert(0, str(PROTO))
experiment_pb, _ = grpc.protos_and_services("photoneye/v1/experiment.proto")
jobs_pb, jobs_grpc = grpc.protos_and_services("photoneye/v1/jobs.proto")
blobs_pb, blobs_grpc = grpc.protos_and_services("photoneye/v1/blobs.proto")

PIECE = 512 << 10
OPTIONS = [("grpc.max_receive_message_length", 16 << 20)]


class Client:
    """A connection to a server such as 127.0.0.1:7733, or, with certificates (PEM bytes), to one that speaks TLS."""

    def __init__(self, target="127.0.0.1:7733", api_key=os.environ.get("PHOTONEYE_API_KEY"), ca_pem=None):
        if ca_pem is None:
            channel = grpc.insecure_channel(target, options=OPTIONS)
        else:
            channel = grpc.secure_channel(target, grpc.ssl_channel_credentials(ca_pem), options=OPTIONS)
        self.metadata = [("authorization", f"Bearer {api_key}")] if api_key else []
        self.experiments = jobs_grpc.ExperimentsStub(channel)
        self.blobs = blobs_grpc.BlobsStub(channel)

    def put(self, data):
        """Uploads bytes; returns their digest."""

        def messages():
            yield blobs_pb.PutBlobRequest(size=len(data))
            for start in range(0, len(data), PIECE):
                yield blobs_pb.PutBlobRequest(bytes=data[start : start + PIECE])

        return self.blobs.Put(messages(), metadata=self.metadata).digest

    def experiment(self, path):
        """Reads a spec; uploads the pictures, the mosaic and the recorded gaze that it names."""
        path = pathlib.Path(path)
        spec = json.loads(path.read_text(encoding="utf-8-sig"))
        files = spec.get("video", {}).get("files")
        if files:
            blobs = [self.put((path.parent / name).read_bytes()) for name in files.pop("paths")]
            spec["video"] = {"clip": {"blobs": blobs, **files}}
        recorded = spec.get("gaze", {}).get("movement", {}).get("recorded", {})
        if "file" in recorded:
            recorded["blob"] = self.put((path.parent / recorded.pop("file")).read_bytes())
        mosaic = spec.get("retina", {}).get("mosaic", {})
        if "file" in mosaic:
            mosaic["blob"] = self.put((path.parent / mosaic.pop("file")).read_bytes())
        return json_format.ParseDict(spec, experiment_pb.Experiment())

    def run(self, experiment, request_id=None):
        """Runs an experiment; returns (counts [frame, cone], cones as a pyarrow table, report).

        What the job warns of is a Python warning.
        """
        request = jobs_pb.CreateJobRequest(experiment=experiment, request_id=request_id or str(uuid.uuid4()))
        job = self.experiments.CreateJob(request, metadata=self.metadata)
        chunks = {}
        request = jobs_pb.StreamResultsRequest(id=job.id)
        for message in self.experiments.StreamResults(request, metadata=self.metadata):
            table = pyarrow.ipc.open_stream(message.bytes).read_all()
            chunks[message.frame, message.first_cone] = table["count"].to_numpy()
        job = self.experiments.GetJob(jobs_pb.JobRequest(id=job.id), metadata=self.metadata)
        if job.state != jobs_pb.Job.SUCCEEDED:
            raise RuntimeError(job.error or jobs_pb.Job.State.Name(job.state))
        for text in job.warnings:
            warnings.warn(text, stacklevel=2)
        frames = sorted({frame for frame, _ in chunks})
        counts = numpy.stack([numpy.concatenate([chunks[k] for k in sorted(chunks) if k[0] == f]) for f in frames])
        pieces = self.experiments.GetCones(jobs_pb.JobRequest(id=job.id), metadata=self.metadata)
        cones = pyarrow.ipc.open_file(io.BytesIO(b"".join(piece.bytes for piece in pieces))).read_all()
        report = json.loads(self.experiments.GetReport(jobs_pb.JobRequest(id=job.id), metadata=self.metadata).json)
        return counts, cones, report


def main():
    """photoneye_client.py SPEC [HOST:PORT]"""
    client = Client(*sys.argv[2:3])
    counts, cones, report = client.run(client.experiment(sys.argv[1]))
    print(f"{counts.shape[0]} frame(s), {counts.shape[1]} cones, {counts.mean():.2f} isomerizations a cone and frame")
    for number, name in enumerate("LMS"):
        of_type = cones["type"].to_numpy() == number
        if of_type.any():
            print(f"{name}: {of_type.sum()} cones, mean {counts[:, of_type].mean():.2f}")


if __name__ == "__main__":
    main()
