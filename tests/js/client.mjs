// A roslibjs program: node client.mjs VERSION URL COMPRESSION
// Publishes each line it reads on /from_client, prints what comes on /to_client, ends on the line "end".
import readline from "node:readline";

const [version, url, compression] = process.argv.slice(2);
const module = await import(version);
const ROSLIB = module.default ?? module;

const ros = new ROSLIB.Ros({ url });
ros.on("error", (error) => {
  console.error(String(error));
  process.exit(1);
});
await new Promise((resolve) => ros.on("connection", resolve));

const reader = new ROSLIB.Topic({ ros, name: "/to_client", messageType: "sensor_msgs/Image", compression });
reader.subscribe((message) => {
  const image = message.data instanceof Uint8Array ? Buffer.from(message.data).toString("base64") : message.data;
  console.log(JSON.stringify(message.bytes ? { raw: message.bytes.length } : { width: message.width, data: image }));
});
const writer = new ROSLIB.Topic({ ros, name: "/from_client", messageType: "std_msgs/String" });
writer.advertise();
console.log("ready");

for await (const line of readline.createInterface({ input: process.stdin })) {
  if (line === "end") break;
  writer.publish(ROSLIB.Message ? new ROSLIB.Message({ data: line }) : { data: line });
}
reader.unsubscribe();
writer.unadvertise();
await new Promise((resolve) => setTimeout(resolve, 50));
ros.close();
process.exit(0);
