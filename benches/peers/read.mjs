// Reads every message of an MCAP file, without decoding its payload:
//
//     read.mjs stream|indexed FILE
import { open, readFile } from "node:fs/promises";
import { createRequire } from "node:module";

const require = createRequire(import.meta.url);
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");

const [how, path] = process.argv.slice(2);
const decompressHandlers = await loadDecompressHandlers();
let count = 0;
let size = 0;
if (how === "stream") {
  const bytes = await readFile(path);
  const reader = new McapStreamReader({ decompressHandlers });
  for (let at = 0; at < bytes.length; at += 4 << 20) {
    reader.append(bytes.subarray(at, at + (4 << 20)));
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type !== "Message") continue;
      count += 1;
      size += record.data.byteLength;
    }
  }
} else {
  const file = await open(path, "r");
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await file.read(buffer, 0, buffer.length, Number(offset));
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  for await (const message of reader.readMessages()) {
    count += 1;
    size += message.data.byteLength;
  }
  await file.close();
}
console.log(count, size);
