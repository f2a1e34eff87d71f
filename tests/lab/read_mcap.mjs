#!/usr/bin/env node
// Prints an MCAP file as lines of JSON, read by the reference TypeScript library
// through the summary, the chunk indexes and the message indexes:
//
//     read_mcap.mjs FILE
//
// The first line describes the file, each further line is one message with its
// data as hex.  Exit status 1, and what is wrong on stderr, when the library
// reports an error or the statistics do not fit what was read.
import { spawnSync } from "node:child_process";
import { createHash } from "node:crypto";
import { open } from "node:fs/promises";
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

let peers = process.env.BUSTAPE_PEERS;
if (!peers) {
  const run = spawnSync(fileURLToPath(new URL("./peers", import.meta.url)), {
    encoding: "utf8",
    stdio: ["ignore", "pipe", "inherit"],
  });
  if (run.status !== 0) process.exit(run.status ?? 125);
  peers = run.stdout.trim();
}
const require = createRequire(peers + "/");
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");

// JSON with 64-bit integers in full and maps as objects
const mark = `\u0001${process.pid}:`;
const json = (object) =>
  JSON.stringify(object, (_, v) =>
    typeof v === "bigint" ? mark + v : v instanceof Map ? Object.fromEntries(v) : v,
  ).replaceAll(new RegExp(`"\\\\u0001${process.pid}:(\\d+)"`, "g"), "$1");

let pending = [];
async function print(object) {
  pending.push(json(object), "\n");
  if (pending.length >= 4096) await flush();
}
async function flush() {
  const text = pending.join("");
  pending = [];
  await new Promise((done, fail) => process.stdout.write(text, (e) => (e ? fail(e) : done())));
}

async function read(path) {
  const file = await open(path, "r");
  try {
    const readable = {
      size: async () => BigInt((await file.stat()).size),
      read: async (offset, length) => {
        const buffer = Buffer.alloc(Number(length));
        const { bytesRead } = await file.read(buffer, 0, buffer.length, Number(offset));
        if (bytesRead !== buffer.length) {
          throw new Error(`read of ${length} bytes at ${offset} is beyond the end of the file`);
        }
        return new Uint8Array(buffer.buffer, buffer.byteOffset, buffer.length);
      },
    };
    const reader = await McapIndexedReader.Initialize({
      readable,
      decompressHandlers: await loadDecompressHandlers(),
    });
    const { statistics, channelsById, schemasById } = reader;
    if (!statistics) throw new Error("the summary has no statistics");
    const counts = {};
    for (const c of channelsById.values()) {
      counts[c.topic] = Number(statistics.channelMessageCounts.get(c.id) ?? 0n) + (counts[c.topic] ?? 0);
    }
    const metadata = [];
    for await (const m of reader.readMetadata()) metadata.push({ name: m.name, metadata: m.metadata });
    const attachments = [];
    for await (const a of reader.readAttachments({ validateCrcs: true })) {
      attachments.push({
        name: a.name,
        media_type: a.mediaType,
        size: a.data.length,
        sha256: createHash("sha256").update(a.data).digest("hex"),
        log_time: a.logTime,
        create_time: a.createTime,
      });
    }
    await print({
      profile: reader.header.profile,
      library: reader.header.library,
      footer: true,
      summary: true,
      chunks: reader.chunkIndexes.length,
      compression: [...new Set(reader.chunkIndexes.map((c) => c.compression))].sort(),
      statistics: {
        message_count: statistics.messageCount,
        schema_count: statistics.schemaCount,
        channel_count: statistics.channelCount,
        attachment_count: statistics.attachmentCount,
        metadata_count: statistics.metadataCount,
        chunk_count: statistics.chunkCount,
        message_start_time: statistics.messageStartTime,
        message_end_time: statistics.messageEndTime,
        channel_message_counts: statistics.channelMessageCounts,
      },
      counts,
      channels: [...channelsById.values()]
        .sort((a, b) => a.id - b.id)
        .map((c) => ({
          id: c.id,
          topic: c.topic,
          schema: schemasById.get(c.schemaId)?.name ?? null,
          schema_encoding: schemasById.get(c.schemaId)?.encoding ?? null,
          message_encoding: c.messageEncoding,
          metadata: c.metadata,
        })),
      metadata,
      attachments,
    });
    let found = 0n;
    for await (const m of reader.readMessages({ validateCrcs: true })) {
      const channel = channelsById.get(m.channelId);
      if (!channel) throw new Error(`a message has channel ${m.channelId}, which the summary lacks`);
      found++;
      await print({
        topic: channel.topic,
        schema: schemasById.get(channel.schemaId)?.name ?? null,
        log_time: m.logTime,
        publish_time: m.publishTime,
        sequence: m.sequence,
        data: Buffer.from(m.data.buffer, m.data.byteOffset, m.data.length).toString("hex"),
      });
    }
    if (found !== statistics.messageCount) {
      throw new Error(`the statistics count ${statistics.messageCount} messages, the message indexes lead to ${found}`);
    }
  } finally {
    await file.close();
  }
}

const path = process.argv[2];
if (process.argv.length !== 3 || path.startsWith("-")) {
  console.error("usage: read_mcap.mjs FILE");
  process.exit(2);
}
try {
  await read(path);
  await flush();
} catch (error) {
  await flush().catch(() => {});
  console.error(`read_mcap.mjs: ${path}: ${error.message ?? error}`);
  process.exitCode = 1;
}
