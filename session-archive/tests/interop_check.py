"""Opens a PAWS session with the official Python packages and tells what they see, as JSON.

usage: interop_check.py SESSION [--decode]

Nothing of ours is used: `mcap` reads the segments with its checksum validation on,
`mcap-protobuf-support` decodes every message with the schemas embedded in the files, and with
--decode PyAV decodes the video. The caller compares with what was written.
"""

import hashlib
import json
import sys
from pathlib import Path

from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def segments(session):
    return sorted((Path(session) / "segments").glob("*.mcap"))


def read(session):
    """Per topic: count, log times, and the decoded messages but for video payloads."""
    topics = {}
    video = {}
    for path in segments(session):
        with open(path, "rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            counts = summary.statistics.channel_message_counts
            found = {}
            # In the order of the file, which is each stream's own order.
            for schema, channel, message, decoded in reader.iter_decoded_messages(
                log_time_order=False
            ):
                found[channel.id] = found.get(channel.id, 0) + 1
                topic = topics.setdefault(
                    channel.topic, {"schema": schema.name, "log_times": [], "messages": []}
                )
                topic["log_times"].append(message.log_time)
                if schema.name == "foxglove.CompressedVideo":
                    stamp = decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos
                    digest = hashlib.sha256(decoded.data).hexdigest()
                    topic["messages"].append(
                        {
                            "timestamp": stamp,
                            "frame_id": decoded.frame_id,
                            "format": decoded.format,
                            "bytes": len(decoded.data),
                            "sha256": digest,
                        }
                    )
                    video.setdefault(channel.topic, (decoded.format, []))[1].append(decoded.data)
                else:
                    topic["messages"].append(
                        MessageToDict(decoded, preserving_proto_field_name=True)
                    )
            if found != {k: v for k, v in counts.items() if v}:
                raise SystemExit(f"{path}: statistics say {counts}, found {found}")
    return topics, video


def decode(form, units):
    """Size and SHA-256 of the luma plane of every picture, in presentation order."""
    import av

    codec = av.CodecContext.create({"h264": "h264", "h265": "hevc"}[form], "r")
    pictures = []
    for unit in list(units) + [None]:
        packets = [av.Packet(unit)] if unit is not None else [None]
        for packet in packets:
            for frame in codec.decode(packet):
                plane = frame.planes[0]
                rows = memoryview(plane)
                luma = b"".join(
                    rows[y * plane.line_size : y * plane.line_size + frame.width]
                    for y in range(frame.height)
                )
                pictures.append(
                    {
                        "width": frame.width,
                        "height": frame.height,
                        "luma_sha256": hashlib.sha256(luma).hexdigest(),
                    }
                )
    return pictures


def main():
    session = sys.argv[1]
    topics, video = read(session)
    result = {"segments": len(segments(session)), "topics": topics}
    if "--decode" in sys.argv[2:]:
        result["pictures"] = {t: decode(form, units) for t, (form, units) in video.items()}
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()
