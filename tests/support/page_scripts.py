"""The page without a browser: its templates compiled by the page's own Vue in Node, its handlers called with events."""

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path

import pytest

#: Compiles a template, renders it with a state; ``find`` looks for nodes by a test, ``fire`` calls a handler.
PRELUDE = """
const fs = require('fs'), vm = require('vm');
const given = JSON.parse(fs.readFileSync(0, 'utf8'));
const plain = (raw) => raw.replace(/&quot;/g, '"').replace(/&#x27;/g, "'").replace(/&lt;/g, '<').replace(/&gt;/g, '>')
  .replace(/&times;/g, 'x').replace(/&amp;/g, '&');
global.document = {createElement: () => { let raw = ''; return {
  set innerHTML(text) { raw = text; }, get textContent() { return plain(raw); },
  get children() { return [{getAttribute: () => plain(raw.slice(raw.indexOf('"') + 1, raw.lastIndexOf('"')))}]; }}; }};
vm.runInThisContext(fs.readFileSync(given.vue, 'utf8'));
console.warn = () => {};
const known = 'Infinity,undefined,NaN,isFinite,isNaN,parseFloat,parseInt,encodeURIComponent,Math,Number,Date,Array,'
  + 'Object,Boolean,String,RegExp,Map,Set,JSON,Intl,BigInt,console,Error,Symbol';
const asked = [];
const state = {...given.state, trigger: (name, values) => asked.push(values || name)};
// As Vue has it: of all that is global only this can be reached from a template.
const has = (_, key) => typeof key === 'string' && key[0] !== '_' && !known.split(',').includes(key);
const scope = new Proxy(state, {has});
const tree = Vue.compile(given.template)(scope, []);
function* nodes(one) {
  if (Array.isArray(one)) { for (const part of one) yield* nodes(part); }
  else if (one && typeof one === 'object' && one.type) { yield one; yield* nodes(one.children); }
}
const find = (test) => [...nodes(tree)].filter((one) => test(one.props || {}, one));
const fire = (id, handler, event) => find((props) => props.id === id)[0].props[handler](event);
const say = (value) => console.log(JSON.stringify(value));
"""


def run_in_node(template, state, script):
    """What a script says of a template that is rendered with a state: a value of JSON for each ``say``."""
    node, client = shutil.which("node"), importlib.util.find_spec("trame_client")
    if node is None or client is None:
        pytest.skip("Node or trame is missing")
    vue = Path(client.origin).parent / "module" / "vue3-www" / "vue.global.js"
    given = json.dumps({"template": template, "state": state, "vue": str(vue)})
    done = subprocess.run(
        [node, "-e", PRELUDE + script], input=given, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]
