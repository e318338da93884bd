// A Raspberry Pi Pico in simulation: both cores of rp2040js on one memory, with what it lacks.
//
//     node rp2040.mjs RP2040JS IMAGE.uf2
//
// Each line of standard input is an object; what is left out stays as it is. The program runs for
// `run_us` and answers with an object in one line.
//   in:  run_us, link (hex, to the UART), keys (text, to Python's prompt), counts (12 conversions of
//        12 bits, by the core's channel), encoder (x4 counts), estop, motor_power
//   out: link (hex), console (text), pins (level of each pin or its duty as a share; -1 = an input),
//        toggles (edges of each pin since the last answer), boots, fetched (addresses in flash that
//        core 1 has touched), starts (us by which conversions begin before and after multiples of
//        40 us from the first)
//
// rp2040js has one core and no boot ROM; neither has this project. The second core is another object
// of its class. What the boot ROM does is done here: boot2's check sequence, the start of core 1, and
// the functions that the image looks up (data sheet, 2.8), each a breakpoint that this file serves.
import { readFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { pathToFileURL } from 'node:url';

const [, , library, image] = process.argv;
const part = (name) => import(pathToFileURL(`${library}/dist/esm/${name}.js`));
const { RP2040 } = await part('rp2040');
const { CortexM0Core } = await part('cortex-m0-core');
const { RPPPB } = await part('peripherals/ppb');
const { USBCDC } = await part('usb/cdc');

const FLASH = 0x10000000;
const RAM = 0x20000000;
const NS = 8; // of a cycle at 125 MHz
const RESET = Symbol('reset');

// --- the image ------------------------------------------------------------------------------------
const uf2 = readFileSync(image);
const written = [];
for (let at = 0; at < uf2.length; at += 512) {
  const block = new DataView(uf2.buffer, uf2.byteOffset + at, 512);
  written.push([block.getUint32(12, true) - FLASH, uf2.subarray(at + 32, at + 32 + block.getUint32(16, true))]);
}

function boot2IsWhole(flash) {
  let crc = 0xffffffff;
  for (let i = 0; i < 252; ++i) {
    crc ^= flash[i] << 24;
    for (let bit = 0; bit < 8; ++bit) crc = crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
  }
  return crc >>> 0 === new DataView(flash.buffer, flash.byteOffset).getUint32(252, true);
}

// --- the boot ROM's functions ---------------------------------------------------------------------
const view = new DataView(new ArrayBuffer(4));
const float = (bits) => (view.setUint32(0, bits), view.getFloat32(0));
const bits = (value) => (view.setFloat32(0, value), view.getUint32(0));
const limited = (value, low, high) => Math.min(high, Math.max(low, Number.isNaN(value) ? 0 : value));
const arithmetic = (work) => (r) => (r[0] = bits(work(float(r[0]), float(r[1]))));

const FUNCTIONS = {
  P3: (r) => (r[0] = r[0].toString(2).replaceAll('0', '').length),
  L3: (r) => (r[0] = Math.clz32(r[0])),
  T3: (r) => (r[0] = r[0] === 0 ? 32 : 31 - Math.clz32(r[0] & -r[0])),
  R3: (r) => (r[0] = parseInt(r[0].toString(2).padStart(32, '0').split('').reverse().join(''), 2)),
  MS: (r, chip) => fill(r, chip),
  S4: (r, chip) => fill(r, chip),
  MC: (r, chip) => copy(r, chip),
  C4: (r, chip) => copy(r, chip),
  IF: () => {},
  EX: (_, chip) => (chip.readable = false),
  FC: () => {},
  CX: (_, chip) => (chip.readable = true),
  RE: (r, chip) => chip.flash.fill(0xff, r[0], r[0] + r[1]),
  RP: (r, chip) => {
    for (let i = 0; i < r[2]; ++i) chip.flash[r[0] + i] &= chip.readUint8(r[1] + i);
  },
};
function fill(r, chip) {
  for (let i = 0; i < r[2]; ++i) chip.writeUint8(r[0] + i, r[1] & 0xff);
}
function copy(r, chip) {
  for (let i = 0; i < r[2]; ++i) chip.writeUint8(r[0] + i, chip.readUint8(r[1] + i));
}
// Single precision, by place in its table.
const FLOATS = {
  0: arithmetic((a, b) => a + b),
  1: arithmetic((a, b) => a - b),
  2: arithmetic((a, b) => a * b),
  3: arithmetic((a, b) => a / b),
  6: arithmetic((a) => Math.sqrt(a)),
  7: (r) => (r[0] = limited(Math.floor(float(r[0])), -(2 ** 31), 2 ** 31 - 1)),
  9: (r) => (r[0] = limited(Math.floor(float(r[0])), 0, 2 ** 32 - 1)),
  11: (r) => (r[0] = bits(r[0] | 0)),
  13: (r) => (r[0] = bits(r[0])),
};
const LOOKUP = 0x40, FIRST = 0x80, TABLE = 0x400, DATA = 0x500, SOFT_FLOAT = 0x600;

function bootRom() {
  const rom = new DataView(new ArrayBuffer(16384));
  const served = [];
  const serve = (work) => {
    const at = FIRST + 4 * served.length;
    rom.setUint16(at, 0xbe00, true); // BKPT
    rom.setUint16(at + 2, 0x4770, true); // BX LR
    served.push(work);
    return at | 1;
  };
  rom.setUint32(0x10, 0x0201754d, true); // 'M', 'u', 1, version 2
  rom.setUint16(0x14, TABLE, true);
  rom.setUint16(0x16, DATA, true);
  rom.setUint16(0x18, LOOKUP | 1, true);
  rom.setUint16(LOOKUP, 0xbe01, true);
  rom.setUint16(LOOKUP + 2, 0x4770, true);
  const code = (name) => name.charCodeAt(0) | (name.charCodeAt(1) << 8);
  const found = new Map();
  for (const [name, work] of Object.entries(FUNCTIONS)) found.set(code(name), serve(work));
  const data = new Map([[code('SF'), SOFT_FLOAT]]);
  for (let i = 0; i < 32; ++i) {
    const missing = () => {
      throw new Error(`the boot ROM's float function ${i} is not simulated`);
    };
    rom.setUint32(SOFT_FLOAT + 4 * i, serve(FLOATS[i] ?? missing), true);
  }
  return { words: new Uint32Array(rom.buffer), served, found, data };
}

// --- the chip -------------------------------------------------------------------------------------
const outside = { counts: new Array(12).fill(0), encoder: 0, estop: false, motor_power: false };
const heard = { link: [], console: '', toggles: new Array(30).fill(0) };
const waiting = { link: [], keys: [] };
let boots = 0;
let starts = [0, 0];
let fetched = new Set();
let machine;

class Machine {
  constructor(before, reason) {
    ++boots;
    const chip = (this.chip = new RP2040());
    chip.logger = { debug() {}, info() {}, warn() {}, error() {} };
    chip.readable = true;
    if (before) {
      chip.sram.set(before.sram);
      chip.flash.set(before.flash);
    } else {
      for (const [at, bytes] of written) chip.flash.set(bytes, at);
    }
    const rom = bootRom();
    chip.bootrom.set(rom.words);
    chip.onBreak = (number) => {
      const { core } = chip;
      const r = core.registers;
      if (number === 1) {
        const table = r[0] === TABLE ? rom.found : rom.data;
        r[0] = table.get(r[1]) ?? 0;
      } else {
        const place = (core.PC - 2 - FIRST) / 4;
        const work = rom.served[place];
        if (!work) throw new Error(`breakpoint at ${core.PC.toString(16)}`);
        work(r, chip);
      }
    };
    this.cores = [chip.core, new CortexM0Core(chip)];
    this.own = [chip.ppb, new RPPPB(chip, 'PPB')];
    this.mail = [[], []]; // to each core
    this.launched = 0; // words of core 1's start that were right
    this.running = false; // core 1
    this.edges = new Uint32Array(4); // interrupt enables of core 1
    chip.setInterrupt = (irq, value) => {
      if (irq === 13) return this.cores[0].setInterrupt(irq, value);
      for (const core of this.cores) core.setInterrupt(irq, value);
    };
    this.twoCores();
    this.pins();
    const watchdog = chip.peripherals[0x40058];
    watchdog.reason = reason;
    watchdog.onWatchdogTrigger = () => {
      this.bitten = watchdog.reason;
      throw RESET; // out of the instruction or the clock: what follows is another life
    };
    chip.peripherals[0x40064].readUint32 = () => (reason || before ? 0 : 0x100); // power-on
    chip.adc.channelValues[0] = Math.round((2500 / 3300) * 4095);
    this.usb();
    if (!boot2IsWhole(chip.flash)) throw new Error('boot2: check sequence is wrong');
    chip.core.VTOR = FLASH + 0x100;
    chip.core.SP = chip.readUint32(FLASH + 0x100);
    chip.core.PC = chip.readUint32(FLASH + 0x104) & ~1;
    this.timers();
  }

  get at() {
    return this.chip.core === this.cores[0] ? 0 : 1;
  }

  // CPUID, the mailboxes and their interrupts, what core 1 reads.
  twoCores() {
    const { chip } = this;
    const { sio } = chip;
    const read = sio.readUint32.bind(sio);
    const write = sio.writeUint32.bind(sio);
    sio.readUint32 = (offset) => {
      if (offset === 0) return this.at;
      if (offset === 0x50) return (this.mail[this.at].length ? 1 : 0) | 2;
      if (offset === 0x58) return this.mail[this.at].shift() ?? 0;
      return read(offset);
    };
    sio.writeUint32 = (offset, value) => {
      if (offset === 0x50) return;
      if (offset !== 0x54) return write(offset, value);
      if (this.at === 0 && !this.running) return this.launch(value >>> 0);
      this.mail[1 - this.at].push(value >>> 0);
    };
    const psm = chip.peripherals[0x40010];
    const force = psm.writeUint32.bind(psm);
    psm.writeUint32 = (offset, value) => {
      force(offset, value);
      if (offset !== 4) return;
      const off = (value & (1 << 16)) !== 0;
      if (off) this.running = false;
      else if (this.wasOff) this.mail[0].push(0);
      this.wasOff = off;
      this.launched = 0;
    };
    for (const [name, size] of [['readUint32', 4], ['readUint16', 2], ['readUint8', 1]]) {
      const plain = chip[name].bind(chip);
      chip[name] = (address) => {
        if (address >>> 26 === FLASH >>> 26) {
          if (this.at === 1) fetched.add(address);
          if (!chip.readable) throw new Error(`flash read at ${address.toString(16)} while it is written`);
        }
        return plain(address, size);
      };
    }
  }

  // What the boot ROM of core 1 answers to multicore_launch_core1_raw().
  launch(word) {
    const right = [0, 0, 1];
    const place = this.launched;
    this.launched = place > 2 || word === right[place] ? place + 1 : word === 0 ? 1 : 0;
    this.mail[0].push(word);
    if (place > 2) this.words[place] = word;
    else this.words = [];
    if (this.launched !== 6) return;
    const core = (this.cores[1] = new CortexM0Core(this.chip));
    core.VTOR = this.words[3];
    core.SP = this.words[4];
    core.PC = this.words[5] & ~1;
    this.running = true;
  }

  pins() {
    const { chip } = this;
    const io = chip.peripherals[0x40014];
    const read = io.readUint32.bind(io);
    const write = io.writeUint32.bind(io);
    const interrupts = () => {
      const on = chip.gpio.some((pin, i) => pin.irqStatus & (this.edges[i >> 3] >>> ((i & 7) * 4)) & 15);
      this.cores[1].setInterrupt(13, on);
    };
    io.readUint32 = (offset) => (offset >= 0x130 && offset < 0x140 ? this.edges[(offset - 0x130) / 4] : read(offset));
    io.writeUint32 = (offset, value) => {
      if (offset >= 0x130 && offset < 0x140) this.edges[(offset - 0x130) / 4] = value;
      else write(offset, value);
      if (offset >= 0xf0) interrupts();
    };
    this.input = (pin, high) => {
      if (chip.gpio[pin].rawInputValue === high) return;
      chip.gpio[pin].setInputValue(high);
      interrupts();
    };
    chip.gpio.forEach((pin, i) => pin.addListener(() => ++heard.toggles[i]));
    this.input(1, true); // the link's line at rest
    // Two MCP3208 at SPI0: three bytes, selected by pins 17 and 20.
    let message = [];
    let first_us;
    for (const select of [chip.gpio[17], chip.gpio[20]]) {
      select.addListener((value) => {
        message = [];
        if (value !== 0) return;
        const now_us = chip.clock.nanos / 1e3;
        first_us ??= now_us;
        const late = ((now_us - first_us + 20) % 40) - 20;
        starts = [Math.min(starts[0], late), Math.max(starts[1], late)];
      });
    }
    const done = chip.clock.createAlarm(() => chip.spi[0].completeTransmit(this.answer));
    chip.spi[0].onTransmit = (byte) => {
      message.push(byte);
      const first = chip.gpio[17].value === 0;
      const second = chip.gpio[20].value === 0;
      this.answer = 0xff;
      if (first !== second && message[0] >> 1 === 3 && message.length > 1) {
        const input = ((message[0] & 1) << 2) | (message[1] >> 6);
        const count = outside.counts[first ? input : 8 + input] ?? 0;
        this.answer = message.length === 2 ? count >> 8 : count & 0xff;
      }
      done.schedule(8e9 / chip.spi[0].clockFrequency);
    };
    chip.uart[0].onByte = (byte) => heard.link.push(byte);
  }

  usb() {
    const { chip } = this;
    this.prompt = new USBCDC(chip.usbCtrl);
    this.prompt.onSerialData = (bytes) => (heard.console += Buffer.from(bytes).toString('latin1'));
  }

  // The line's bytes, 40 us each, and the encoder's edges.
  timers() {
    const { chip } = this;
    const line = chip.clock.createAlarm(() => {
      if (waiting.link.length) chip.uart[0].feedByte(waiting.link.shift());
      if (this.prompt.initialized && waiting.keys.length) this.prompt.sendSerialByte(waiting.keys.shift());
      const turned = this.turned ?? outside.encoder;
      this.turned = turned + Math.sign(outside.encoder - turned);
      const phase = ((this.turned % 4) + 4) % 4;
      this.input(8, phase === 1 || phase === 2);
      this.input(9, phase >= 2);
      this.input(10, outside.estop);
      this.input(11, outside.motor_power);
      line.schedule(40e3);
    });
    line.schedule(40e3);
  }

  run(us) {
    const { clock } = this.chip;
    const end = clock.nanos + us * 1e3;
    try {
      while (clock.nanos < end) this.instruction();
    } catch (error) {
      if (error !== RESET) throw error;
      machine = new Machine(this.chip, this.bitten);
      machine.run((end - clock.nanos) / 1e3);
    }
  }

  // One of each core's.
  instruction() {
    const { chip, cores, own } = this;
    let spent = 0;
    for (let i = 0; i < (this.running ? 2 : 1); ++i) {
      const core = cores[i];
      if (core.waiting) {
        core.waiting = (core.idle = (core.idle ?? 0) + 1) % 64 !== 0; // an event of the other core
        spent = Math.max(spent, 2);
        continue;
      }
      chip.core = core;
      chip.ppb = own[i];
      spent = Math.max(spent, core.executeInstruction());
      if (i === 0 && core.PC >>> 28 === 1) chip.readable = true; // boot2 was run again
    }
    chip.core = cores[0];
    chip.ppb = own[0];
    chip.clock.tick(spent * NS);
  }

  levels() {
    const { chip } = this;
    return chip.gpio.map((pin, i) => {
      if (pin.functionSelect !== 4) return pin.value < 2 ? pin.value : -1;
      const channel = chip.pwm.channels[(i >> 1) & 7];
      return (i & 1 ? channel.cc >>> 16 : channel.cc & 0xffff) / (channel.top + 1);
    });
  }
}

machine = new Machine();
for await (const text of createInterface({ input: process.stdin })) {
  const told = JSON.parse(text);
  for (const name of Object.keys(outside)) if (name in told) outside[name] = told[name];
  waiting.link.push(...Buffer.from(told.link ?? '', 'hex'));
  waiting.keys.push(...Buffer.from(told.keys ?? '', 'latin1'));
  machine.run(told.run_us ?? 0);
  const said = {
    link: Buffer.from(heard.link).toString('hex'),
    console: heard.console,
    pins: machine.levels(),
    toggles: heard.toggles,
    boots,
    fetched: [...fetched].slice(0, 20),
    starts,
  };
  heard.link = [];
  heard.console = '';
  heard.toggles = new Array(30).fill(0);
  console.log(JSON.stringify(said));
}
