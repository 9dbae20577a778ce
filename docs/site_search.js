// Browsers start no worker from a page that is opened as a file. The search then runs in a frame of the page.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const waiting = [];
      const frame = document.body.appendChild(document.createElement("iframe"));
      frame.hidden = true;
      const inner = frame.contentWindow;
      const deliver = (data) => inner.dispatchEvent(new MessageEvent("message", { data }));
      const answer = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      inner.postMessage = (data) => setTimeout(answer, 0, data);
      this.postMessage = (data) => waiting.push(data);
      const script = inner.document.createElement("script");
      script.src = url;
      script.onload = () => {
        this.postMessage = (data) => setTimeout(deliver, 0, data);
        waiting.forEach(this.postMessage);
      };
      inner.document.body.append(script);
    }
  };
}
