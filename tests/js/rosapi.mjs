// A client of roslibjs that asks rosapi, run as a program of its own by the tests.
//
// node rosapi.mjs roslib1|roslib2 PORT PLAN
//
// PLAN is JSON: a list of [method of Ros, ...arguments] and of ["param", method of Param, name, ...arguments]. One JSON
// line is written per answer: {"ask": number, "answer": what the callback got} or {"ask": number, "failed": text}.

import { createInterface } from "node:readline";

const [library, port, text] = process.argv.slice(2);
const loaded = await import(library);
const ROSLIB = loaded.default ?? loaded;

const say = (what) => process.stdout.write(JSON.stringify(what) + "\n");

const ros = new ROSLIB.Ros({ url: `ws://127.0.0.1:${port}` });
ros.on("error", (error) => say({ error: String(error?.message ?? error) }));
ros.on("connection", () => {
  say({ client: 0, connected: true });
  JSON.parse(text).forEach(([method, ...args], ask) => {
    let owner = ros;
    if (method === "param") {
      const [named, name, ...rest] = args;
      [owner, method, args] = [new ROSLIB.Param({ ros, name }), named, rest];
    }
    const failed = (error) => say({ ask, failed: String(error) });
    owner[method](...args, (...answer) => say({ ask, answer }), failed);
  });
});

createInterface({ input: process.stdin }).on("close", () => process.exit(0));
