// Answers of the server: a header of JSON, then arrays that are used where they lie.
const TYPES = { float32: Float32Array, int16: Int16Array, uint8: Uint8Array };

export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, told] of Object.entries(header.arrays)) {
    const count = told.shape.reduce((one, other) => one * other, 1);
    arrays[name] = { shape: told.shape, data: new TYPES[told.type](buffer, 4 + length + told.at, count) };
  }
  return { ...header, arrays };
}

async function sent(path, value) {
  const answer = await fetch(path, {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value),
  });
  if (!answer.ok) {
    const said = await answer.json().catch(() => ({ said: `the server failed (${answer.status})` }));
    throw new Error(said.said);
  }
  return answer;
}

export const ask = async (wish) => unpack(await (await sent("answer", wish)).arrayBuffer());
export const save = async (wish, name) => (await sent("save", { wish, name })).json();

export async function recipe() {
  const answer = await fetch("recipe");
  if (!answer.ok) throw new Error((await answer.json()).said);
  return answer.json();
}
