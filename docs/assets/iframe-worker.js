// Browsers load no worker from file://. The search of the site then runs in a hidden frame instead.
if (location.protocol === "file:") {
  window.IFrameWorker = window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      const inner = (this.inner = frame.contentWindow)
      inner.document.open()
      inner.reply = data => this.dispatchEvent(new MessageEvent("message", { data }))
      inner.document.write(`<script>
        postMessage = data => reply(data)
        importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise(resolve => {
          const script = document.createElement("script")
          script.src = url
          script.onload = resolve
          document.head.append(script)
        })), Promise.resolve())
      <\/script><script src="${url}"><\/script>`)
      this.ready = new Promise(resolve => inner.addEventListener("load", resolve))
      inner.document.close()
    }
    postMessage(data) {
      this.ready.then(() => this.inner.dispatchEvent(new MessageEvent("message", { data })))
    }
    terminate() {
      this.inner.frameElement.remove()
    }
  }
}
