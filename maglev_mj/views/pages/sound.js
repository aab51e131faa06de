// The force of a device as sound.
//
//     const sound = forceSound();
//     button.onclick = () => sound.toggle();   // starts or ends it and returns true if it is on; browsers ask for a click or key
//     sound.play(forces, duration);            // forces [N], equally spaced over `duration` seconds of the listener's time
//
// Call `play` with the forces since the last call and the time that they took, at least ten times a second: pieces are joined
// without a gap. In slow motion `duration` is longer than the simulated time, and the pitch falls with it. A force is held until
// the next one, as the actuator holds it, so that its steps are heard. A steady force and slow pushing are not: they are
// filtered out below 35 Hz. Needs no other script.
"use strict";

function forceSound() {
  let context = null, input, ends = 0;
  return {
    get on() { return context !== null; },

    toggle() {
      if (context) {
        const last = context;
        context = null;
        input.gain.setTargetAtTime(0, last.currentTime, 0.01);      // no click
        setTimeout(() => last.close(), 60);
        return false;
      }
      context = new AudioContext();
      input = new GainNode(context, { gain: 0 });
      input.gain.setTargetAtTime(0.12, context.currentTime + 0.1, 0.05);
      const slow = new BiquadFilterNode(context, { type: "highpass", frequency: 35 });
      const loud = new DynamicsCompressorNode(context, { threshold: -18, ratio: 20 });
      input.connect(slow).connect(loud).connect(context.destination);
      ends = 0;
      return true;
    },

    play(forces, duration) {
      if (!context || !forces.length) return;
      const now = context.currentTime, count = Math.round(duration * context.sampleRate);
      if (count < 1 || ends > now + 0.3) return;                    // the clock of the sound is behind that of the pictures
      const buffer = context.createBuffer(1, count, context.sampleRate), values = buffer.getChannelData(0);
      for (let i = 0; i < count; i++) values[i] = forces[Math.floor(i * forces.length / count)];
      const piece = new AudioBufferSourceNode(context, { buffer });
      piece.connect(input);
      if (ends < now + 0.01) ends = now + 0.06;                     // late, or the first: a little in hand for the next pieces
      piece.start(ends);
      ends += count / context.sampleRate;
    },
  };
}
