// Reads a recording with another implementation of MCAP than the one that wrote it: see docs/recording.md.
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import { open } from "node:fs/promises";
const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers: await loadDecompressHandlers() });
for (const c of reader.channelsById.values()) {
  const s = reader.schemasById.get(c.schemaId);
  console.log(c.topic, c.messageEncoding, s.name, s.encoding);
}
const schema = JSON.parse(new TextDecoder().decode([...reader.schemasById.values()].find((s) => s.name === "maglev_mj.Sample").data));
console.log("position.z:", schema.properties.position.properties.z.unit, " hand.rx:", schema.properties.hand.properties.rx.unit);
let n = 0, deepest = Infinity;
for await (const m of reader.readMessages({ topics: ["/maglev/sample"] })) {
  n++; deepest = Math.min(deepest, JSON.parse(new TextDecoder().decode(m.data)).position.z);
}
console.log(n, "samples, deepest", deepest * 1e3, "mm");
