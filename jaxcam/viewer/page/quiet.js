// What viser's client says on every page, and what of its libraries is out of date, is no message to
// whoever looks at robots. All else is said.
{
  const usual = /^(Detected chrome version|WebGL support: true|Embedded data loaded|THREE\.Clock: This module)/;
  for (const kind of ["log", "warn"]) {
    const say = console[kind].bind(console);
    console[kind] = (...words) => usual.test(String(words[0])) || say(...words);
  }
}
